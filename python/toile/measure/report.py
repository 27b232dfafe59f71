"""One self-contained HTML page about a run: what was registered, how well, where it is worst and why."""

from __future__ import annotations

import html
import json
from pathlib import Path

import numpy as np

from .. import kernels
from ..errors import UserError
from ..io.files import output_file, write_text
from ..io.run import open_run
from .evaluate import evaluate
from .page import HEAT, cards, document, figure, flatten, heat, plot, short_number, table

WORST = 40  # frames shown with pictures
SIZE = (360, 220)  # (height, width) of a picture [px]
BODY, CLOTH = (222, 190, 170), ((86, 124, 168), (170, 110, 90), (110, 150, 100), (150, 120, 170))
HEAT_MM = 10.0  # distance to the scan at the upper end of the colours
UNSEEN = (176, 174, 170)  # over holes of the scan
GRAVE = {"good": 0.0, "doubtful": 1e6, "wrong": 2e6}  # of a verdict, when frames are ranked


def write_report(run: Path | str, out: Path | str | None = None, more: str = "") -> Path:
    """Writes the page of a run (default RUN/report.html) and returns its path. UserError where there is no run.

    `more`: HTML that stands before the frames, such as the section of an avatar made from the run.
    """
    opened = open_run(run)
    path = output_file(out or opened.path / "report.html")
    write_text(path, _Page(opened, evaluate(opened)).html(more))
    return path


class _Page:
    def __init__(self, run, result):
        self.run, self.result = run, result
        self.flat = {f["frame"]: flatten({k: v for k, v in f.items() if k != "frame"}) for f in result["per_frame"]}
        self.judged = {
            f["frame"]: (f["verdict"], "; ".join(f["reasons"])) for f in result["per_frame"] if "verdict" in f
        }

    def html(self, more):
        ok, failed = self.result["all"].get("frames_ok", 0), self.result["all"].get("frames_failed", 0)
        title = f"{self.run.scene.name}: {ok} frames registered" + (f", {failed} failed" if failed else "")
        ranked = self._ranked()
        shown = "".join(self._frame(number, why) for number, why in ranked[:WORST])
        layers = ", ".join(["body", *self.run.garments])
        settings = html.escape(json.dumps(self.run.config, indent=1))
        return document(
            title,
            f"<p class='soft'>Layers: {html.escape(layers)}. Lengths in mm.</p>"
            f"{self._warnings()}{self._verdicts()}{cards(flatten(self.result['all']))}<h2>Errors over time</h2><div class='plots'>{self._plots()}</div>{more}"
            f"<h2>Frames, worst first</h2>{_scale()}{shown}<h2>Settings and versions</h2><pre>{settings}</pre>",
        )

    def _warnings(self):
        told = [*self.run.status.warnings(), *self.result["warnings"]]
        return "".join(f"<p class='why'>{html.escape(w)}</p>" for w in told)

    def _verdicts(self):
        """How many frames are good, doubtful and wrong, and why those that are not good are not."""
        if not self.judged:
            return ""
        rows = [(str(n), verdict, why) for n, (verdict, why) in sorted(self.judged.items()) if why]
        counts = ", ".join(f"{count} {name}" for name, count in self.result["all"]["verdicts"].items())
        return f"<h2>Verdicts: {counts}</h2>{table(('frame', 'verdict', 'why'), rows) if rows else ''}"

    def _plots(self):
        names = list(dict.fromkeys(name for values in self.flat.values() for name in values))
        plots = []
        for name in names:
            points = [(n, v[name]) for n, v in sorted(self.flat.items()) if v.get(name) is not None]
            if points:
                plots.append(plot(name, points))
        return "".join(plots)

    def _ranked(self):
        """[(frame, why)]: failed ones first, then those judged wrong and doubtful, then by the measure that is farthest
        above its median over the run."""
        ranked = []
        medians = {}
        for name in {n for values in self.flat.values() for n in values}:
            values = [v[name] for v in self.flat.values() if v.get(name) is not None]
            medians[name] = float(np.median(values)) if values else 0.0
        for number in self.run.frames.tolist():
            if number not in self.flat:
                ranked.append(
                    (np.inf, number, f"failed: {self.run.diagnostics.at(number).get('reason', 'not finished')}")
                )
                continue
            score, why = max(
                (
                    (_excess(n, v, medians[n]), _words(n, v, medians[n]))
                    for n, v in self.flat[number].items()
                    if v is not None
                ),
                default=(0.0, "no measure"),
            )
            contact = _contact(self.run.diagnostics.at(number))
            verdict, reasons = self.judged.get(number, ("good", ""))
            why = "; ".join(text for text in (f"{verdict}: {reasons}" if reasons else "", contact, why) if text)
            ranked.append((score + (100 if contact else 0) + GRAVE[verdict], number, why))
        ranked.sort(key=lambda item: (-item[0], item[1]))
        return [(number, why) for _, number, why in ranked]

    def _frame(self, number, why):
        pictures = "" if number not in self.flat else self._pictures(number)
        return (
            f"<section class='frame'><h3>frame {number} <span class='why'>{html.escape(why)}</span></h3>"
            f"<div class='row'>{pictures}</div></section>"
        )

    def _pictures(self, number):
        run, up = self.run, self.run.scene.up
        track = (run.track.at(number), run.track.faces, BODY)
        figures = [("tracked, front", [track], 0), ("tracked, back", [track], np.pi)]
        if run.garments:
            layers = [(run.inner.at(number), run.inner.faces, BODY)]
            inner = [("inner, front", list(layers), 0)]
            for i, garment in enumerate(run.garments.values()):
                layers.append((garment.at(number), garment.faces, CLOTH[i % len(CLOTH)]))
            figures += inner + [("layers, front", layers, 0), ("layers, back", layers, np.pi)]
        figures += self._heat(number)
        return "".join(figure(render(parts, angle, up), caption) for caption, parts, angle in figures)

    def _heat(self, number):
        """The tracked surface and the garments coloured by their distance to the frame's scan; nothing without one."""
        try:
            scan = self.run.capture.frame(number).scan
        except UserError:
            return []
        if scan is None:
            return []
        index = kernels.SurfaceIndex(scan.vertices, scan.faces)

        border = kernels.border_vertices(scan.faces, len(scan.vertices))

        def coloured(surface):
            V, F = surface.at(number), surface.faces
            face, _, bary, distance = index.closest(V)
            beyond = (border[scan.faces[face]] | (bary < 1e-6)).all(1)  # the nearest point lies on the scan's border
            colour = heat(distance[F].mean(1) * 1e3 / HEAT_MM)
            colour[beyond[F].any(1)] = UNSEEN
            return V, F, colour

        surfaces = {"tracked": [coloured(self.run.track)]}
        if self.run.garments:
            surfaces["garments"] = [coloured(garment) for garment in self.run.garments.values()]
        return [
            (f"{name} to scan, {side}", parts, angle)
            for name, parts in surfaces.items()
            for side, angle in (("front", 0), ("back", np.pi))
        ]


def _scale():
    """The colours of the pictures named "to scan"."""
    stops = ", ".join(f"rgb{c}" for c in HEAT)
    return (
        f"<p class='soft'>Distance to scan: 0<span class='scale' style='background: linear-gradient(to right, {stops})'></span>"
        f"{HEAT_MM:g} mm and more; grey over holes of the scan.</p>"
    )


def render(parts, angle, up="z", size=SIZE):
    """Shaded layers [(V, F, colour)] from the front (0) or elsewhere about the up axis [rad]: a picture (H,W,3) uint8."""
    V = np.concatenate([p[0] for p in parts])
    offset = np.cumsum([0, *(len(p[0]) for p in parts)])
    F = np.concatenate([p[1] + o for p, o in zip(parts, offset)]).astype(np.int32)
    colour = np.concatenate([np.broadcast_to(p[2], (len(p[1]), 3)) for p in parts])
    camera = _view(V, angle, up)
    height, width = size[0] * 2, size[1] * 2
    span = max(np.ptp(camera[:, 1]) / height, np.ptp(camera[:, 0]) / width) * 1.08
    distance = 6.0
    camera = camera + [0, 0, distance]
    focal = distance / span
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    hit = kernels.raster(camera, F, K, (height, width)).face
    normals = kernels.vertex_normals(camera, F)[F].mean(1)
    light = np.clip(0.35 + 0.65 * np.abs(normals @ np.array([0.35, -0.45, -0.82])), 0, 1)
    shaded = np.concatenate([colour * light[:, None], [[244, 243, 240]]])
    return shaded[hit].reshape(size[0], 2, size[1], 2, 3).mean((1, 3)).round().astype(np.uint8)


def _view(V, angle, up):
    """Vertices in a camera that looks at the person's front: x right, y down, z forward, centred."""
    axes = {
        "z": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
        "y": ((-1, 0, 0), (0, -1, 0), (0, 0, -1)),
        "x": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    }
    P = (V - (V.min(0) + V.max(0)) / 2) @ np.array(axes[up], dtype=np.float64).T
    c, s = np.cos(angle), np.sin(angle)
    return P @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def _excess(name, value, median):
    """How far a measure is on its bad side, relative to its median; IoU and what was observed are bad when low."""
    if _good_when_high(name):
        return (median - value) * 10
    if name == "intersections_left":
        return 50.0 if value else 0.0
    return (value - median) / max(abs(median), 1e-9)


def _good_when_high(name):
    return "iou" in name or "observed" in name


def _words(name, value, median):
    if name == "intersections_left" and value:
        return f"{int(value)} triangle pairs of garments with the body or one another still intersect"
    worse = "below" if _good_when_high(name) else "above"
    return f"{name.replace('_', ' ')} is {short_number(value)}, {worse} the run's median of {short_number(median)}"


def _contact(diagnostics):
    """In words, when a stage reports contact that the method cannot represent."""
    for stage, values in diagnostics.items():
        if isinstance(values, dict) and values.get("unsupported_contact"):
            return f"{stage}: hands touch the cloth, which the method cannot represent"
    return ""
