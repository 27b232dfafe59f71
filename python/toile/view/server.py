"""The page's server: only this machine can ask it, and it only reads."""

from __future__ import annotations

import json
import sys
import threading
from collections import OrderedDict
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote

from ..errors import UserError, first_line
from ..kernels import InputError
from .shown import Shown

PAGE = Path(__file__).parent / "page"
FILES = {
    "": ("view.html", "text/html"),
    "view.js": ("view.js", "text/javascript"),
    "gl.js": ("gl.js", "text/javascript"),
}
BYTES = "application/octet-stream"
KEPT = 512 << 20  # bytes of answers that are kept
RULES = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; img-src 'self' blob: data:"


class Answers:
    """Answers of the shown paths, the last KEPT bytes of them kept. `0/points/tshirt/17` names the path by its place, what is
    asked, and its arguments."""

    def __init__(self, shown: Sequence[Shown]):
        self.shown, self.kept, self.size, self.lock = shown, OrderedDict(), 0, threading.Lock()

    def __call__(self, parts: tuple[str, ...]) -> tuple[bytes, str]:
        """The body and its type. UserError: there is none."""
        if parts == ("facts",):
            return json.dumps([shown.facts() for shown in self.shown]).encode(), "application/json"
        with self.lock:
            if parts in self.kept:
                self.kept.move_to_end(parts)
                return self.kept[parts]
        made = self._made(*parts)
        with self.lock:
            self.size += len(made[0]) if parts not in self.kept else 0  # another thread may have made it meanwhile
            self.kept[parts] = made
            while self.size > KEPT:
                self.size -= len(self.kept.popitem(last=False)[1][0])
        return made

    def _made(self, which="", what="", *given):
        if not which.isdecimal() or int(which) >= len(self.shown):
            raise UserError("no such page")
        shown = self.shown[int(which)]
        still = {"faces": BYTES, "split": BYTES, "texture": "image/png"}
        if what in still and len(given) == 1:
            return getattr(shown, what)(*given), still[what]
        kinds = {
            "points": (2, BYTES),
            "posed": (3, BYTES),
            "colours": (3, BYTES),
            "scan": (1, BYTES),
            "picture": (2, "image/jpeg"),
        }
        if what not in kinds or len(given) != kinds[what][0] or not given[-1].isdecimal():
            raise UserError("no such page")
        return getattr(shown, what)(*given[:-1], int(given[-1])), kinds[what][1]


def serve(shown: Sequence[Shown], port: int) -> ThreadingHTTPServer:
    """A server on the loopback, not started; port 0 takes a free one. UserError: the port is taken."""
    answers = Answers(shown)

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"  # connections stay open

        def do_GET(self):
            if self.headers.get("Host", "").partition(":")[0] not in ("127.0.0.1", "localhost"):
                return self.answer(403, b"only this machine may ask", "text/plain")  # a foreign name that leads here
            parts = tuple(unquote(part) for part in self.path.partition("?")[0].strip("/").split("/"))
            if len(parts) == 1 and parts[0] in FILES:
                name, kind = FILES[parts[0]]
                return self.answer(200, (PAGE / name).read_bytes(), f"{kind}; charset=utf-8")
            try:
                self.answer(200, *answers(parts))
            except (UserError, InputError, OSError) as error:
                self.answer(404, first_line(error).encode(), "text/plain; charset=utf-8")

        def answer(self, code, body, kind):
            self.send_response(code)
            for name, value in {"Content-Type": kind, "Content-Length": len(body), "Cache-Control": "no-store",
                                "Content-Security-Policy": RULES, "X-Content-Type-Options": "nosniff"}.items():  # fmt: skip
                self.send_header(name, str(value))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    class Server(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *asked):
            if not isinstance(sys.exception(), ConnectionError):  # of a browser that went away nothing is said
                super().handle_error(*asked)

    try:
        return Server(("127.0.0.1", port), Handler)
    except OSError as error:
        raise UserError(f"--port {port}: {first_line(error)}") from None
