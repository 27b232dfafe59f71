"""The program that `toile detect` runs where no other is named: mediapipe's holistic model, in an environment of its own.

    python holistic.py PICTURES OUT [PICTURES OUT ...]

Each PICTURES is a folder with a picture a camera, each OUT an empty folder that gets keypoints.json and masks/CAMERA.png.
Of toile only the lists of keypoints are read: mediapipe wants another numpy. Its landmarks are fractions of the picture's
sides, so that times the sides they are pixels whose first has its centre at (0.5, 0.5).
"""

import json
import sys
from pathlib import Path

import cv2
import mediapipe
import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "io"))
from skeletons import SKELETONS, rows_of

POINTS, ROWS = len(SKELETONS["mediapipe543"]), rows_of("mediapipe543")
GROUPS = {"pose_landmarks": 0, "face_landmarks": 33, "left_hand_landmarks": 501, "right_hand_landmarks": 522}
FOUND = 0.9  # confidence of a face or hand that was found: the model says no more of their points
MASKED = 0.5


def main(folders):
    options = {"static_image_mode": True, "enable_segmentation": True}
    with mediapipe.solutions.holistic.Holistic(**options) as model:
        for pictures, out in zip(folders[::2], folders[1::2]):
            one_instant(model, Path(pictures), Path(out))


def one_instant(model, pictures, out):
    points = {}
    (out / "masks").mkdir(parents=True)
    for path in sorted(p for p in pictures.iterdir() if p.suffix.lower() in (".png", ".jpg", ".jpeg")):
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)  # as toile reads it
        if picture is None:
            sys.exit(f"{path}: cannot be read as a picture")
        found = model.process(np.ascontiguousarray(picture[..., ::-1]))
        points[path.stem] = rows_of(found, *picture.shape[:2])
        if found.pose_landmarks is not None and found.segmentation_mask is not None:
            mask = 255 * (found.segmentation_mask > MASKED).astype(np.uint8)
            cv2.imwrite(str(out / "masks" / f"{path.stem}.png"), mask)
    (out / "keypoints.json").write_text(json.dumps({"names": list(ROWS), "points": points}))


def rows_of(found, height, width):
    """[[u, v, confidence], ...] of the named points; confidence 0 where nothing was found, or outside the picture."""
    rows = np.zeros((POINTS, 3))
    for group, first in GROUPS.items():
        marks = getattr(found, group)
        for i, mark in enumerate(marks.landmark if marks is not None else ()):
            sure = mark.visibility if group == "pose_landmarks" else FOUND
            inside = 0 <= mark.x < 1 and 0 <= mark.y < 1
            rows[first + i] = mark.x * width, mark.y * height, sure if inside else 0
    return [[round(float(value), 3) for value in rows[row]] for row in ROWS.values()]


if __name__ == "__main__":
    main(sys.argv[1:])
