"""Equations as MathML, written when the site is built: browsers draw it themselves, so pages need no script for it."""

import html
import re

from latex2mathml.converter import convert

# what pymdownx.arithmatex leaves of $...$ and $$...$$
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)
BAR = re.compile(r"<mo[^>]*>&#x0007C;</mo>")  # of |x|: without the space that an operator has


def on_page_content(content, **_):
    """Called by mkdocs with the HTML of each page."""
    content = BLOCK.sub(lambda m: f'<div class="equation">{mathml(m[1], "block")}</div>', content)
    return INLINE.sub(lambda m: mathml(m[1], "inline"), content)


def mathml(latex, display):
    drawn = convert(html.unescape(latex), display=display)
    return BAR.sub('<mo stretchy="false" lspace="0" rspace="0">&#x0007C;</mo>', drawn)
