"""What a run will do: the stages that a capture asks for."""

from dataclasses import dataclass

from ..io.capture import Capture
from .scanning import lacks_scan


@dataclass(frozen=True)
class Step:
    """One stage of a plan: whether it runs, and the line of the scene or the data that decides."""

    stage: str
    runs: bool
    why: str


def plan(capture: Capture) -> list[Step]:
    """The stages that this capture asks for, in order, and those left out, each with why."""
    scene, names = capture.scene, [g.name for g in capture.scene.garments]
    printed = [g.name for g in capture.scene.garments if g.prints]
    first = capture.frame(capture.frames[0])
    cloth = f"[[garment]] {', '.join(names)}" if names else "no [[garment]] in scene.toml"
    given = [("labels/*.png", bool(first.labels)), ("label of scan.ply", first.scan_labels is not None)]
    given += [(f'[scene] segmenter = "{scene.segmenter}"', bool(scene.segmenter))]
    labels = " and ".join(name for name, there in given if there) or "labels"
    points = "keypoints.json" if first.keypoints else "no keypoints.json"
    points = points if first.points3d is None else "keypoints3d.json is given"
    lacking = lacks_scan(capture, first.number)
    scans = "scan.ply is given" if first.scan else "no scan.ply; pictures with masks or labels"
    scans = scans if first.scan or lacking else "no pictures with masks or labels to make one"
    return [
        Step("stereo", lacking, scans),
        Step("reconstruct", first.points3d is None and first.keypoints is not None, points),
        Step("track", True, f'[body] model = "{scene.body_model}"'),
        Step("segment", bool(names), f"{cloth}; {labels}" if names else cloth),
        Step("dress", bool(names), cloth),
        Step("prints", bool(printed), f"prints = true: {', '.join(printed)}" if printed else "no prints = true"),
        Step("inner", bool(names), cloth),
        Step("face", scene.face_keypoints, "[face] keypoints" if scene.face_keypoints else "no [face] keypoints"),
    ]
