"""Equations as MathML, written when the site is built: browsers draw it themselves, so pages need no script for it."""

import html
import re

from latex2mathml.converter import convert

# what pymdownx.arithmatex leaves of $...$ and $$...$$
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)


def on_page_content(content, **_):
    """Called by mkdocs with the HTML of each page."""
    content = BLOCK.sub(lambda m: f'<div class="equation">{convert(html.unescape(m[1]), display="block")}</div>', content)
    return INLINE.sub(lambda m: convert(html.unescape(m[1])), content)
