"""A run measured against its scans and, where the capture has it, against the truth."""

from __future__ import annotations

import tomllib
from collections import defaultdict
from itertools import combinations
from pathlib import Path

import numpy as np

from .. import kernels
from ..errors import UserError
from ..io.body import load_body_model
from ..io.capture import open_capture
from ..io.run import OK, Status
from ..scene import OBSERVED
from .evidence import evidence, nothing
from .truth import mean_measures, millimetres, open_truth, second_difference


def evaluate(run):
    """Measures as {"all": {...}, "per_frame": [...]}; lengths in mm; None where the truth or the thing is missing.

    "all" holds means over the frames that are ok (its p95 is the mean of theirs), but the sum of intersections_left.

    joint_mm: mean distance of the model's joints to the true ones of the same name. track_to_scan_mm: only the tracked
    vertices that were found on the scan, to its surface: small by definition. evidence: over all outside vertices and the
    whole scan, see measure/evidence.py. label_iou: by area over the outside of the tracked surface, against the label of
    the nearest point of the true outer surface (garments, and the body that no garment covers).
    garment: over all vertices of the template, seen or not. observed, share of them that lie on the labelled scan;
    boundary_mm, each loop's vertices to the true border that is its own; boundary_all_mm, the same over the vertices of all
    loops together; loop_observed, share of a loop's vertices that lie on the scan and whose opening was seen; surface_mm,
    vertices to the true garment's surface; correspondence_mm, vertices to their true places through the truth's map;
    jitter_mm, mean length of the second difference over time of that error (consecutive frames only).
    inner: outside vertices to the true body's surface, hidden_mm under the garments (confidence 0), visible_mm elsewhere;
    hidden_model_mm, the hidden ones of the model alone, posed and shaped by the tracking, before anything was fused of the
    sequence; hidden_share, of the outside vertices.
    intersections_left: triangle pairs of garments with the inner skin, whole, and with one another, by exact predicates.
    seconds: mean a frame.
    """
    run = Path(run)
    return _Evaluation(run).result()


class _Evaluation:
    def __init__(self, run):
        import zarr

        if not (run / "registered.zarr").exists():
            raise UserError(f"{run}: no registered.zarr; is it a run of `toile register`?")
        self.run, self.store = run, zarr.open_group(str(run / "registered.zarr"), mode="r")
        self.config = tomllib.loads((run / "config.toml").read_text(encoding="utf-8"))
        self.capture = open_capture(self.config["capture"])
        body = self.store.attrs["body_model"]
        path = self.capture.root / body if body.endswith(".npz") else body
        self.model = load_body_model(path, up=self.capture.scene.up)
        self.garments = self.store.attrs["scene"]["garments"]
        self.rest = self.model.rest(self.store["shape"][:])
        self.truth = open_truth(self.capture, [g["name"] for g in self.garments])
        self.outside = ~self.model.inside

    def result(self):
        numbers, done = self.store["frames"][:], self.store["done"][:]
        per_frame, errors = [], defaultdict(dict)
        for row, number in enumerate(int(n) for n in numbers):
            if done[row] == OK:
                per_frame.append({"frame": number, **self._frame(row, number, errors)})
        everything = mean_measures(per_frame or [self._nothing()])
        everything.pop("frame", None)
        for name, by_frame in errors.items():
            everything["garment"][name]["jitter_mm"] = second_difference(by_frame)
        if everything.get("intersections_left") is not None:
            everything["intersections_left"] = sum(f["intersections_left"] for f in per_frame)
        everything["seconds"] = self._seconds()
        everything["frames_ok"], everything["frames_failed"] = len(per_frame), int(len(numbers) - len(per_frame))
        return {"all": everything, "per_frame": per_frame}

    def _frame(self, row, number, errors):
        true = self.truth is not None and number in self.truth
        tracked = self.store["track/vertices"][row]
        out = self._nothing()
        out["joint_mm"] = self._joints(row, number) if true else None
        out |= self._evidence(row, number, tracked)
        if not self.garments:
            return out
        inner = self.store["inner/vertices"][row]
        cloth = {g["name"]: self.store[f"garment/{g['name']}/vertices"][row] for g in self.garments}
        faces = {g["name"]: self.store[f"garment/{g['name']}/faces"][:] for g in self.garments}
        layers = [(inner, self.model.skin_faces), *((cloth[n], faces[n]) for n in cloth)]
        pairs = (kernels.intersecting_pairs(*over, *under) for over, under in combinations(layers[::-1], 2))
        out["intersections_left"] = int(sum(len(p) for p in pairs))
        for garment in self.garments:
            seen = self.store[f"confidence/{garment['name']}"][row] == OBSERVED
            shares = {name: float(seen[loop].mean()) for name, loop in garment["loops"].items()}
            out["garment"][garment["name"]] |= {"observed": float(seen.mean()), "loop_observed": shares}
        if not true:
            return out
        for garment in self.garments:
            name = garment["name"]
            measures, errors[name][number] = self.truth.garment_errors(name, garment["loops"], cloth[name], number)
            out["garment"][name] |= measures
        out["label_iou"] = self._labels(self.store["labels"][row], tracked, number)
        hidden = self.store["confidence/inner"][row] == 0
        model = self.model.skin(*self.rest, *self._pose(row))
        alone = self.truth.body_errors(model, hidden, self.outside, number)["hidden_mm"]
        share = float((hidden & self.outside).sum() / self.outside.sum())
        out["inner"] = self.truth.body_errors(inner, hidden, self.outside, number)
        out["inner"] |= {"hidden_model_mm": alone, "hidden_share": share}
        return out

    def _nothing(self):
        """The measures of one frame, none of them known."""
        garment = (
            "observed",
            "loop_observed",
            "boundary_mm",
            "boundary_all_mm",
            "surface_mm",
            "correspondence_mm",
            "jitter_mm",
        )
        return {
            "joint_mm": None,
            "track_to_scan_mm": None,
            "evidence": nothing(),
            "label_iou": None,
            "garment": {g["name"]: dict.fromkeys(garment) for g in self.garments},
            "inner": dict.fromkeys(("hidden_mm", "visible_mm", "hidden_model_mm", "hidden_share")),
            "intersections_left": None,
        }

    def _joints(self, row, number):
        x, (true, names) = self._model_joints(row), self.truth.joints(number)
        at = [self.model.joint_names.index(n) for n in names if n in self.model.joint_names]
        there = [i for i, n in enumerate(names) if n in self.model.joint_names]
        return millimetres(np.linalg.norm(x[at] - true[there], axis=1))

    def _evidence(self, row, number, tracked):
        """What the frame itself shows of the tracked surface; nothing where the capture has lost it."""
        try:
            frame = self.capture.frame(number)
        except UserError:
            return {}
        confidence, joints = self.store["confidence/track"][row], self._model_joints(row)
        found = evidence(frame, self.capture.cameras, self.model, tracked, joints, confidence, self.outside)
        seen = (confidence == OBSERVED) & self.outside
        near = frame.scan.index.closest(tracked[seen])[3] if frame.scan is not None and seen.any() else []
        return {"track_to_scan_mm": millimetres(near), "evidence": found}

    def _pose(self, row):
        return self.store["pose/rotations"][row], self.store["pose/translation"][row]

    def _model_joints(self, row):
        return self.model.joint_transforms(self.rest[1], *self._pose(row))[1]

    def _labels(self, labels, tracked, number):
        """IoU by label over the outside of the tracked surface."""
        V, F, label = self.truth.outer(number, {g["name"]: g["label"] for g in self.garments}, bare=True)
        truth = label[kernels.SurfaceIndex(V, F).closest(tracked)[0]]
        area = np.zeros(len(tracked))
        np.add.at(area, self.model.f.ravel(), np.repeat(kernels.face_areas(tracked, self.model.f) / 3, 3))
        area *= self.outside
        iou = {}
        for name, label in self.capture.scene.labels.items():
            a, b = labels == label, truth == label
            union = area[a | b].sum()
            iou[name] = float(area[a & b].sum() / union) if union > 0 else None
        return iou

    def _seconds(self):
        total, frames = defaultdict(float), defaultdict(set)
        for entry in Status(self.run / "status.jsonl").lines():
            if entry.get("ok"):
                total[entry["stage"]] += entry["seconds"]
                frames[entry["stage"]].add(entry["frame"])
        return {stage: total[stage] / len(frames[stage]) for stage in total}
