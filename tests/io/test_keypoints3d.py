"""keypoints3d.json: keypoints in space that a capture brings."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from toile.config import ReconstructSettings, preset
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.keypoints import keypoints3d_json, read_keypoints3d
from toile.pipeline.plan import plan
from toile.pipeline.run import register
from toile.scene import Points3D
from toile.stages.reconstruct import triangulate

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


def test_what_is_written_is_read_again(tmp_path):
    points = Points3D(("a", "b"), np.array([[1, 2, 3.0], [np.nan] * 3]), np.array([0.01, np.inf]), np.zeros(2))
    (tmp_path / "keypoints3d.json").write_text(keypoints3d_json(points))
    back = read_keypoints3d(tmp_path / "keypoints3d.json")
    assert back.names == points.names
    assert np.array_equal(back.points, points.points, equal_nan=True) and np.array_equal(back.sigma, points.sigma)


@pytest.mark.parametrize(
    "text, said",
    [
        ("[]", "holds a list"),
        ('{"names": ["a"]}', "points: expected"),
        ('{"names": "a", "points": [null]}', "names: expected a list"),
        ('{"names": ["a", "a"], "points": [null, null]}', "names: a stands there twice"),
        ('{"names": ["a"], "points": []}', "points has 0 rows, names 1"),
        ('{"names": ["a"], "points": [[1, 2, 3]]}', r"points\[0\]: expected \[x, y, z, sigma\]"),
        ('{"names": ["a"], "points": [[1, 2, 3, 0]]}', r"points\[0\]: expected three finite numbers"),
        ('{"names": ["a", "b"], "points": [null, [1, 2, NaN, 1]]}', r"points\[1\]: expected three finite numbers"),
        ('{"names": ["a", "b"], "points": [null, [null, null, null, 1]]}', r"points\[1\]: expected \[x"),
        ('{"names": ["a"], "points": [["1", 2, 3, 1]]}', r"points\[0\]: expected \[x"),
        ('{"names": ["a"], "points": [[1, 2, 3, 1%s]]}' % ("0" * 400), "points: holds a number beyond 64 bits"),
    ],
)
def test_what_is_none_is_refused_by_file_and_field(tmp_path, text, said):
    (tmp_path / "keypoints3d.json").write_text(text)
    with pytest.raises(UserError, match=f"keypoints3d.json: {said}"):
        read_keypoints3d(tmp_path / "keypoints3d.json")


def test_a_frame_is_tracked_by_the_points_that_it_brings(tmp_path):
    """The bundled capture without garment, its 2D keypoints replaced by those triangulated from them."""
    root = shutil.copytree(SAMPLE, tmp_path / "capture")
    scene = (root / "scene.toml").read_text()
    (root / "scene.toml").write_text(scene[: scene.index("[[garment]]")])
    opened = open_capture(root)
    given = register(root, tmp_path / "given", preset("draft"), opened.frames[:1])
    for number in opened.frames:
        points = triangulate(opened.frame(number).keypoints, opened.cameras, ReconstructSettings())
        (opened.folder(number) / "keypoints3d.json").write_text(keypoints3d_json(points))
        (opened.folder(number) / "keypoints.json").unlink()
    assert "keypoints3d.json is given" in next(s.why for s in plan(open_capture(root)) if s.stage == "reconstruct")
    brought = register(root, tmp_path / "brought", preset("draft"), opened.frames[:1])
    from toile import open_run

    runs = [open_run(tmp_path / name) for name in ("given", "brought")]
    places = [run.track.at(opened.frames[0]) for run in runs]
    apart = np.abs(places[0] - places[1])  # the file's decimals let some vertices meet another face of the thinned scan
    assert given.ok == brought.ok == opened.frames[:1] and apart.mean() < 2e-4 and apart.max() < 1e-2
