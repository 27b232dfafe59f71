"""Where keypoints say that a person is."""

import numpy as np

from toile.io.skeletons import BODIES, SKELETONS
from toile.vision.segmenters.limbs import limbs_of

NAMES = SKELETONS["coco17"]
UPRIGHT = {  # of a picture 200 px wide and 300 high
    "nose": (100, 40), "ear L": (108, 38), "ear R": (92, 38), "shoulder L": (120, 70), "shoulder R": (80, 70),
    "elbow L": (130, 110), "elbow R": (70, 110), "wrist L": (135, 150), "wrist R": (65, 150), "hip L": (112, 150),
    "hip R": (88, 150), "knee L": (113, 200), "knee R": (87, 200), "ankle L": (113, 250), "ankle R": (87, 250),
}  # fmt: skip


def rows(**unsure):
    """Keypoints (17,3); those named unsure by `part_side` have that confidence."""
    return np.array(
        [[*UPRIGHT.get(w, (0, 0)), unsure.get(w.replace(" ", "_"), float(w in UPRIGHT))] for w in BODIES["coco17"]]
    )


def test_background_is_less_likely_on_the_limbs_and_more_from_a_fifth_of_the_trunk_on():
    limbs = limbs_of(NAMES, rows())
    assert limbs.length == 80
    told = limbs.background((300, 200))
    assert told[110, 100] == told[225, 113] == told[90, 125] == -1  # trunk, shin, upper arm
    assert np.abs(told[225, [121, 129, 150]] - [0, 1, 1]).max() < 1e-6  # 8, 16 and 37 px off the shin
    assert told.min() == -1 and told.max() == 1


def test_the_same_is_told_of_a_picture_of_another_size():
    small, points = limbs_of(NAMES, rows()).background((300, 200)), rows()
    points[:, :2] *= 3
    large = limbs_of(NAMES, points).background((900, 600))[1::3, 1::3]
    assert np.abs(small - large).mean() < 0.05


def test_nothing_is_told_without_shoulders_and_hips():
    assert limbs_of(NAMES, rows(hip_L=0.2)) is None
    assert limbs_of(NAMES, np.zeros((0, 3))) is None
    assert limbs_of(NAMES, rows(knee_L=0.2)).background((300, 200))[190, 113] > 0  # what is not seen has no bone


def test_a_trunk_that_points_at_the_camera_is_not_as_short_as_it_looks():
    points = rows()
    points[[NAMES.index(f"body.upperleg01.{side}") for side in "LR"], 1] = 75
    assert limbs_of(NAMES, points).length > 40


def test_points_far_outside_of_the_picture_are_no_harm():
    points = rows()
    points[NAMES.index("body.wrist.L"), :2] = 1e9, -1e9
    assert np.isfinite(limbs_of(NAMES, points).background((300, 200))).all()
