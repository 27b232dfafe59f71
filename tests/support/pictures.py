"""Held-out pictures of the bundled capture as avatars of a known blur would show them."""

from pathlib import Path

import cv2
import numpy as np

from toile.avatar.measure.heldout import HeldOutPicture
from toile.io.capture import open_capture

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
SKIN, SHIRT = 1, 3


def pictures(frame=0, cameras=("cam00", "cam03"), blur=(("layered", 1.0), ("baseline", 3.0))):
    """The captured pictures, and the same blurred by sigma [px] as each avatar's."""
    captured = open_capture(SAMPLE).frame(frame)
    for camera in cameras:
        image = captured.images[camera] / 255.0
        rendered = {name: cv2.GaussianBlur(image, (0, 0), sigma) if sigma else image for name, sigma in blur}
        rows, columns = np.nonzero(captured.labels[camera] == SHIRT)
        hem = np.stack([columns, np.full(len(columns), rows.max())], axis=1).astype(float)
        yield HeldOutPicture(
            frame, camera, image, captured.masks[camera], captured.labels[camera],
            captured.labels[camera] == SKIN, rendered, {"hem": hem}, 3.0,
        )  # fmt: skip
