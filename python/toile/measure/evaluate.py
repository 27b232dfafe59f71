"""A run measured against its scans and, where the capture has it, against the truth."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from .. import kernels
from ..errors import UserError
from ..frame_numbers import frame_ranges
from ..io.layout import FAILED, VERDICTS
from ..io.run import Run, open_run
from ..scene import HIDDEN, OBSERVED
from .empty_masks import pixel_side, wrongly_empty
from .evidence import evidence, nothing
from .glimpse import glimpse
from .judged import JudgedLayer
from .motion import Followed, MotionError, Slip
from .truth import mean_measures, millimetres, open_truth

INNER = (
    "hidden_mm",
    "visible_mm",
    "observed_p90_mm",
    "hidden_model_mm",
    "hidden_share",
    "jitter_mm",
    "acceleration",
)


def evaluate(run: Run | Path | str) -> dict:
    """Measures of a run, opened or a folder, as {"all": {...}, "per_frame": [...], "warnings": [...]}; lengths in mm; None
    where the truth or the thing is missing, or where the truth has no map of the run's template, which is then warned of.

    "all" holds means over the frames that are ok (its p95 is the mean of theirs), but the sum of intersections_left.

    joint_mm: mean distance of the model's joints to the true ones of the same name. track_to_scan_mm: only the tracked
    vertices that were found on the scan, to its surface: small by definition. evidence: over all outside vertices and the
    whole scan, see measure/evidence.py. fingertip_mm, face_mm: the tracked surface's fingertips and facial keypoints to the
    true ones, seen or not. label_iou: by area over the outside of the tracked surface, against the label of
    the nearest point of the true outer surface (garments, and the body that no garment covers).
    garment: over all vertices of the template, seen or not. observed, share of them that lie on the labelled scan;
    observed_p90_mm, what 90 % of those stay within of the true surface (inner's: of the true body); folds, pairs of its own
    faces that go through one another, true_folds, those of the true garment;
    boundary_mm, each loop's vertices to the true border that is its own; boundary_all_mm, the same over the vertices of all
    loops together; boundary_missed_mm, the other way, the true border's vertices to the loop; loop_observed, share of a loop's vertices that lie on the scan and whose opening was seen; surface_mm,
    vertices to the true garment's surface, surface_missed_mm, its vertices to this surface; correspondence_mm, vertices to their true places through the truth's map;
    shared_mm, what a vertex errs by on average over the frames, in axes that go with the true garment, which no picture can
    show; slip_mm, the errors without that; jitter_mm, mean length of the second difference over time of that error (consecutive frames only); acceleration, mean
    length of the second difference of the vertices as a share of their true places'.
    inner: outside vertices to the true body's surface, hidden_mm under the garments (confidence 0), visible_mm elsewhere;
    hidden_model_mm, the hidden ones of the model alone, posed and shaped by the tracking, before anything was fused of the
    sequence; hidden_share, of the outside vertices; jitter_mm and acceleration as those of garments, of the visible
    vertices against the points of the true body that are nearest in the first frame.
    intersections_left: triangle pairs of garments with the inner skin, whole, and with one another, by exact predicates.
    seconds: mean a frame, of one that was given again the last. verdicts: how many registered frames are good, doubtful and
    wrong, by measure/verdicts.py; a frame has its "verdict" and "reasons".
    """
    return _Evaluation(run if isinstance(run, Run) else open_run(run)).result()


class _Evaluation:
    def __init__(self, run):
        self.run, self.capture, self.model = run, run.capture, run.body_model
        self.rest = self.model.rest(run.shape)
        self.labels = {name: garment.label for name, garment in run.garments.items()}
        self.truth = open_truth(self.capture)
        self.known = [name for name in run.garments if self.truth is not None and self.truth.has(name)]
        self.mapped = {name: self.truth.maps(name, run.garments[name].faces) for name in self.known}
        self.borders = {name: self.truth.border_names(name, self.model) for name in self.known}
        self.outside = ~self.model.inside
        self.followed, self.slips, self.lost = None, defaultdict(Slip), []
        self.empty, self.changed = {}, []  # {frame: masks left out}, frames

    def result(self):
        per_frame, motions = [], defaultdict(MotionError)
        for number in self.run.ok:
            per_frame.append({"frame": number, **self._frame(number, motions)})
        everything = mean_measures(per_frame or [self._nothing()])
        everything.pop("frame", None)
        for name, motion in motions.items():
            (everything["garment"][name] if name else everything["inner"]).update(motion.measures())
        for name, slip in self.slips.items():
            everything["garment"][name].update(slip.measures())
        if everything.get("intersections_left") is not None:
            everything["intersections_left"] = sum(f["intersections_left"] for f in per_frame)
        everything["seconds"] = self._seconds()
        everything["verdicts"] = self._verdicts(per_frame)
        everything["frames_ok"], everything["frames_failed"] = len(per_frame), int((self.run.done == FAILED).sum())
        return {"all": everything, "per_frame": per_frame, "warnings": self._warnings()}

    def _warnings(self):
        """What the truth cannot measure of this run's garments, and frames without evidence."""
        unknown = [] if self.truth is None else [n for n in self.run.garments if n not in self.known]
        said = [
            f"garment {name}: the truth has no such garment: it is not measured, nor are the labels" for name in unknown
        ]
        if self.lost:
            lost = f"frames {frame_ranges(self.lost, 4)}: they can no more be read of {self.capture.root}"
            said.append(f"{lost}: no evidence is measured of them")
        if self.changed:
            changed = f"frames {frame_ranges(self.changed, 4)}: the capture's files are no more those"
            said.append(f"{changed} that were registered: they are measured against what lies there now")
        if outdated := self.run.outdated:
            said.append(f"{outdated}: frames are measured by what stands there now")
        if self.empty:
            where, many = frame_ranges([*self.empty], 4), sum(self.empty.values())
            empty = f"frames {where}: masks that are empty although the person is in their pictures, {many} in all"
            said.append(f"{empty}, are left out of silhouette_iou")
        without = [name for name, mapped in self.mapped.items() if not mapped]
        return said + [
            f"garment {name}: the truth has no map of this template: correspondence_mm and jitter_mm are not measurable"
            for name in without
        ]

    def _verdicts(self, per_frame):
        """Counts of the registered frames by verdict, each frame's and its reasons noted with it; None in older runs."""
        if self.run.verdict is None:
            return None
        for measures in per_frame:
            measures["verdict"] = VERDICTS[self.run.verdict[self.run.row(measures["frame"])]]
            measures["reasons"] = self.run.diagnostics.at(measures["frame"]).get("reasons", [])
        verdicts = [measures["verdict"] for measures in per_frame]
        return {name: verdicts.count(name) for name in VERDICTS}

    def _frame(self, number, motions):
        """The measures of one frame; `motions` {garment, or None for the inner layer: MotionError} hear of it."""
        run, true = self.run, self.truth is not None and number in self.truth
        tracked = run.track.at(number)
        out = self._nothing()
        if true:
            out |= {"joint_mm": self._joints(number), **self._fine_parts(tracked, number)}
        out |= self._evidence(number, tracked)
        if not run.garments:
            return out
        inner, cloth = run.inner.at(number), {name: garment.at(number) for name, garment in run.garments.items()}
        out["intersections_left"] = self._intersections(inner, cloth)
        for name, garment in run.garments.items():
            seen = garment.confidence.at(number) == OBSERVED
            shares = {loop: float(seen[at].mean()) for loop, at in garment.loops.items()}
            folds = len(kernels.self_intersections(cloth[name], garment.faces))
            out["garment"][name] |= {"observed": float(seen.mean()), "loop_observed": shares, "folds": folds}
        if not true:
            return out
        for name in self.known:
            out["garment"][name] |= self._true_garment(name, cloth[name], number, motions)
        if len(self.known) == len(run.garments):
            out["label_iou"] = self._labels(run.labels.at(number), tracked, number)
        out["inner"] |= self._true_inner(inner, number, motions)
        return out

    def _intersections(self, inner, cloth):
        """Pairs of triangles of garments with the inner skin and with one another."""
        layers = [(inner, self.model.skin_faces), *((cloth[name], g.faces) for name, g in self.run.garments.items())]
        pairs = (kernels.intersecting_pairs(*over, *under) for over, under in combinations(layers[::-1], 2))
        return int(sum(len(p) for p in pairs))

    def _true_garment(self, name, V, number, motions):
        """The errors of a garment V (g,3) in a frame against the true one."""
        garment, correspondence = self.run.garments[name], (self.mapped[name], self.borders[name])
        seen = garment.confidence.at(number) == OBSERVED
        measures, error = self.truth.garment_errors(
            name, garment.loops, V, garment.faces, number, *correspondence, seen
        )
        if error is not None:
            motions[name].add(number, V, V - error)
            self.slips[name].add(error, V - error, garment.faces)
        return measures

    def _true_inner(self, inner, number, motions):
        """The errors of the inner layer (n,3) in a frame against the true body."""
        confidence = self.run.inner.confidence.at(number)
        hidden = confidence == HIDDEN
        measures = self.truth.body_errors(inner, hidden, self.outside, number, confidence == OBSERVED)
        model = self.model.skin(*self.rest, *self.run.pose.at(number))
        measures["hidden_model_mm"] = self.truth.body_errors(model, hidden, self.outside, number)["hidden_mm"]
        measures["hidden_share"] = float((hidden & self.outside).sum() / self.outside.sum())
        body = self.truth.body(number)
        self.followed = self.followed or Followed(inner, ~hidden & self.outside, *body)
        motions[None].add(number, inner[self.followed.at], self.followed.places(body[0]))
        return measures

    def _nothing(self):
        """The measures of one frame, none of them known."""
        garment = (
            "observed",
            "observed_p90_mm",
            "folds",
            "true_folds",
            "loop_observed",
            "boundary_mm",
            "boundary_all_mm",
            "boundary_missed_mm",
            "surface_mm",
            "surface_missed_mm",
            "correspondence_mm",
            "slip_mm",
            "shared_mm",
            "jitter_mm",
            "acceleration",
        )
        return {
            "joint_mm": None,
            "fingertip_mm": None,
            "face_mm": None,
            "track_to_scan_mm": None,
            "evidence": nothing(),
            "label_iou": None,
            "garment": {name: dict.fromkeys(garment) for name in self.run.garments},
            "inner": dict.fromkeys(INNER),
            "intersections_left": None,
        }

    def _joints(self, number):
        x, (true, names) = self._model_joints(number), self.truth.joints(number)
        at = [self.model.joint_names.index(n) for n in names if n in self.model.joint_names]
        there = [i for i, n in enumerate(names) if n in self.model.joint_names]
        return millimetres(np.linalg.norm(x[at] - true[there], axis=1))

    def _fine_parts(self, tracked, number):
        """Fingertips and facial keypoints, which skin alone shows and few pixels."""
        places = dict(zip(self.model.keypoint_names, self.model.keypoints(tracked, self._model_joints(number))))
        distance = {
            name: np.linalg.norm(places[name] - true)
            for name, true in self.truth.keypoints(number).items()
            if name in places
        }
        tips = [d for name, d in distance.items() if name.startswith("hand_") and "-tip" in name]
        face = [d for name, d in distance.items() if name.startswith("face.")]
        return {"fingertip_mm": millimetres(tips), "face_mm": millimetres(face)}

    def _evidence(self, number, tracked):
        """What the frame itself shows of the tracked surface; nothing where the capture has lost it."""
        try:
            frame = self.capture.frame(number)
        except UserError:
            self.lost.append(number)
            return {}
        self.changed += [number] if self.run.changed(number) else []
        confidence, joints = self.run.track.confidence.at(number), self._model_joints(number)
        body = JudgedLayer("body", None, tracked, self.model.skin_faces, confidence, np.flatnonzero(self.outside))
        empty = self._empty(frame, body)
        frame = replace(frame, masks={name: mask for name, mask in frame.masks.items() if name not in empty})
        measures = evidence(frame, self.capture.cameras, self.model, tracked, joints, confidence, self.outside)
        seen = (confidence == OBSERVED) & self.outside
        near = frame.scan.index.closest(tracked[seen])[3] if frame.scan is not None and seen.any() else []
        return {"track_to_scan_mm": millimetres(near), "evidence": measures}

    def _empty(self, frame, body):
        """Names of the frame's masks that are empty although the person is in their pictures, noted for a warning."""
        cameras = self.capture.cameras
        masks = {name: (mask, pixel_side(cameras[name], body.vertices)) for name, mask in frame.masks.items()}
        empty = wrongly_empty(glimpse(frame), cameras, body, masks)
        self.empty |= {frame.number: len(empty)} if empty else {}
        return empty

    def _model_joints(self, number):
        return self.model.joint_transforms(self.rest[1], *self.run.pose.at(number))[1]

    def _labels(self, labels, tracked, number):
        """IoU by label over the outside of the tracked surface."""
        V, F, label = self.truth.outer(number, self.labels, bare=True)
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
        took = defaultdict(dict)  # {stage: {frame: seconds}}
        for entry in self.run.status.lines():
            if entry.get("ok") and "frame" in entry:
                took[entry["stage"]][entry["frame"]] = entry["seconds"]
        return {stage: float(np.mean([*frames.values()])) for stage, frames in took.items()}
