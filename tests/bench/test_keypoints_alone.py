"""Keypoints of a tracked body beside those detected."""

import numpy as np

from bench.keypoints_alone import measure
from toile.io.run import open_run


def test_every_sure_keypoint_counts_and_the_learnt_offsets_bring_the_body_nearer(sample_run):
    run = open_run(sample_run)
    found = measure(run)
    sure = 0
    for number in run.ok:
        seen = run.capture.keypoints(number)
        known = np.isin(seen.names, run.body_model.keypoint_names)
        sure += sum(int((rows[known, 2] > 0.3).sum()) for rows in seen.points.values())
    assert len(found["body"]) == len(found["body and offsets"]) == sure > 1000 and len(found["free"]) <= sure
    assert np.median(found["body and offsets"]) < np.median(found["body"]) < 10
