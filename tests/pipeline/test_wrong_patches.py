"""Labels of which a third is wrong, in patches that stay where they are, with half of the views missing."""

from dataclasses import replace
from pathlib import Path

from tests.support.lasting_blobs import WrongPatches, iou_by_label
from toile.config import SegmentSettings
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.scene import Mesh
from toile.stages import segment

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
SHARE = 0.3
LEAST = {"tshirt": 0.96, "trousers": 0.97, "skin": 0.95, "hair": 0.75}


def test_labels_are_found_among_wrong_patches():
    settings = SegmentSettings()
    capture, faces = open_capture(SAMPLE), load_body_model("anny").f
    patches, cameras = WrongPatches(capture, SHARE), list(capture.cameras)[::2]
    samples, shares = [], []
    for number in capture.frames[:2]:
        frame = capture.frame(number)
        labels, share = patches.images(number, cameras)
        images = {name: frame.images[name] for name in cameras}
        samples.append(
            (replace(frame, images=images, masks={}, labels=labels), Mesh(patches.truth.body(number)[0], faces))
        )
        shares.append(share)
    assert min(shares) > 0.28
    model = segment.prepare(capture.scene, capture.cameras, samples, faces, settings)
    for frame, body in samples:
        found = segment.evidence(frame, capture.cameras, model, body, faces, settings)
        segmented = segment.segment(capture.scene, found, model, body, faces, settings)
        iou = iou_by_label(capture, patches.truth, frame, segmented)
        assert all(iou[name] > least for name, least in LEAST.items()), iou
