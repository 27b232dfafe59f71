"""What a run will do: the stages that a capture asks for."""

from dataclasses import dataclass

from ..errors import UserError
from ..io.capture import CHECKED, Capture
from ..scene import Frame
from .scanning import lacks_scan


@dataclass(frozen=True)
class Step:
    """One stage of a plan: whether it runs, and the line of the scene or the data that decides."""

    stage: str
    runs: bool
    why: str


def plan(capture: Capture) -> list[Step]:
    """The stages that this capture asks for, in order, and those left out, each with why. UserError: no frame of the first few
    can be read."""
    scene, names = capture.scene, [g.name for g in capture.scene.garments]
    printed = [g.name for g in scene.garments if g.prints]
    first = _first_readable(capture)
    cloth = f"[[garment]] {', '.join(names)}" if names else "no [[garment]] in scene.toml"
    return [
        _stereo(capture, first),
        _reconstruct(first),
        Step("track", True, f'[body] model = "{scene.body_model}"'),
        Step("segment", bool(names), f"{cloth}; {_labels(capture, first)}" if names else cloth),
        Step("dress", bool(names), cloth),
        Step("prints", bool(printed), f"prints = true: {', '.join(printed)}" if printed else "no prints = true"),
        Step("motion", len(capture.frames) > 1, f"{len(capture.frames)} frames"),
        Step("inner", bool(names), cloth),
        _face(capture, first),
        _view(capture),
    ]


def _first_readable(capture: Capture) -> Frame:
    """The first frame, or the first of the next few where that is bad: a run records it and goes on."""
    errors = []
    for number in capture.frames[:CHECKED]:
        try:
            return capture.frame(number)
        except UserError as error:
            errors.append(error)
    raise errors[0]


def _stereo(capture: Capture, first: Frame) -> Step:
    lacking = next((number for number in capture.frames if lacks_scan(capture, number)), None)
    if lacking is not None:
        where = "" if lacking == capture.frames[0] else f"frame {lacking}: "
        return Step("stereo", True, f"{where}no scan.ply; pictures with masks or labels")
    return Step("stereo", False, "scan.ply is given" if first.scan else "no pictures with masks or labels to make one")


def _reconstruct(first: Frame) -> Step:
    if first.points3d is not None:
        return Step("reconstruct", False, "keypoints3d.json is given")
    if first.keypoints is None:
        return Step("reconstruct", False, "no keypoints.json")
    if len(first.keypoints.points) < 2:
        return Step("reconstruct", False, "keypoints.json of one camera alone")
    return Step("reconstruct", True, "keypoints.json")


def _labels(capture: Capture, first: Frame) -> str:
    """What gives the garments' labels."""
    scene = capture.scene
    given = [("labels/*.png", any(capture.labelled(number) for number in capture.frames))]
    given += [("label of scan.ply", first.scan_labels is not None)]
    given += [(f'[scene] segmenter = "{scene.segmenter}"', bool(scene.segmenter))]
    there = " and ".join(name for name, there in given if there)
    return there or "no labels/*.png, no label of scan.ply, no [scene] segmenter"


def _face(capture: Capture, first: Frame) -> Step:
    if not capture.scene.face_keypoints:
        return Step("face", False, "no [face] keypoints")
    found = [points.names for points in (first.keypoints, first.points3d) if points is not None]
    facial = any(name.startswith("face.") for names in found for name in names)
    return Step("face", facial, "[face] keypoints" if facial else "[face] keypoints, but no face.* among the keypoints")


def _view(capture: Capture) -> Step:
    """What depends on the view, which an avatar learns."""
    if len(capture.cameras) < 2:
        return Step("view", False, "one camera in cameras.json")
    told = capture.scene.view_dependent
    return Step("view", told, f"[cameras] view_dependent = {str(told).lower()}")
