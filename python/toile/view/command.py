"""The command `toile view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .. import speech
from ..console import Apart, Garments, garments_of, is_avatar
from ..errors import UserError


def view(
    path: Annotated[Path, typer.Argument(help="a run, a capture, an avatar, or a folder that toile animate made")],
    beside: Annotated[Path | None, typer.Option(help="another, shown beside it at the same frames")] = None,
    motion: Annotated[
        Path | None, typer.Option(help="of an avatar: a run, a .bvh file or an .npz; default its training poses")
    ] = None,
    garment: Garments = None,
    apart: Apart = True,
    port: Annotated[int, typer.Option(help="of the page; default a free one", min=0, max=65535)] = 0,
    browser: Annotated[bool, typer.Option(help="open it in a browser")] = True,
):
    """Look at a run over time in a browser: layers, scan, cameras with pictures, confidence and errors as colours. Ctrl-C ends it."""
    import webbrowser

    from .server import serve
    from .shown import Shown

    garments = garments_of(garment)
    if garments and not is_avatar(path):
        raise UserError(f"--garment: {path} is no avatar")
    if motion and not is_avatar(path):
        raise UserError(f"--motion {motion}: {path} is no avatar")
    shown = [
        Shown(path, posable(path, motion, garments, apart)),
        *([Shown(beside, posable(beside, motion, apart=apart))] if beside else []),
    ]
    for warning in (warning for one in shown for warning in one.warnings):
        speech.warn(warning)
    server = serve(shown, port)
    address = f"http://127.0.0.1:{server.server_address[1]}/"
    speech.result(f"{address}  (only from this machine; Ctrl-C ends it)", address=address)
    if browser:
        webbrowser.open(address)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        pass
    finally:
        server.server_close()


def posable(path, motion=None, garments=(), apart=True):
    """The PosedAvatar of an avatar's folder, see there for the arguments; None of any other folder."""
    if not (path / "avatar.json").exists():
        return None
    from ..avatar.drive.posing import PosedAvatar

    return PosedAvatar(path, motion, garments, apart)
