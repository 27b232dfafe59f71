"""Scans beside a calibration: in every ending, in other units, of other frames."""

import numpy as np
import pytest

from tests.support.cube import check
from tests.support.imported import imported, rig, save
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.rig import Options, read_rig


def test_masks_scans_units_and_offsets_arrive(tmp_path):
    from toile.io.mesh import write_mesh
    from toile.scene import Mesh

    made = rig(tmp_path / "their", numbers=(0, 1, 2, 3, 4))
    for v in made:
        save(tmp_path / "their" / "masks" / v.name / "2.png", (v.width, v.height), 255)  # in colour
    triangle = Mesh(np.array([[0, 0, 0], [0, 0, 1700.0], [100, 0, 0]]), np.array([[0, 1, 2]]))
    write_mesh(tmp_path / "their" / "scans" / "mesh_000001.obj", triangle)
    imported(tmp_path / "their", tmp_path / "ours", units="mm", offsets={"left": 2})
    capture = open_capture(tmp_path / "ours")
    check(capture.cameras, made, metres=1000, within=1e-3)
    first = capture.frame(0)
    assert int(first.images["left"][0, 0, 0]) - int(first.images["front"][0, 0, 0]) == 2  # its third picture
    assert capture.frame(0).masks["left"].all() and capture.frame(2).masks["front"].all()
    np.testing.assert_allclose(np.ptp(capture.frame(1).scan.vertices, axis=0), [0.1, 0, 1.7], atol=1e-6)


def test_the_confidence_of_a_scan_is_kept_in_other_units(tmp_path):
    from toile.io.mesh import write_mesh
    from toile.scene import Mesh

    rig(tmp_path / "their", numbers=(0,))
    corners, confidence = np.array([[0, 0, 0], [0, 0, 1700.0], [100, 0, 0]]), np.array([1.0, 0.0, 0.5])
    write_mesh(tmp_path / "their" / "scans" / "0.ply", Mesh(corners, np.array([[0, 1, 2]]), confidence=confidence))
    imported(tmp_path / "their", tmp_path / "ours", units="mm")
    scan = open_capture(tmp_path / "ours").frame(0).scan
    assert np.allclose(scan.confidence, confidence, atol=1e-6) and np.allclose(scan.vertices[1], [0, 0, 1.7])


@pytest.mark.parametrize("ending", ["ply", "obj", "off", "stl"])
def test_scans_of_every_ending_arrive_and_those_of_other_frames_are_said(tmp_path, ending):
    import trimesh

    rig(tmp_path, numbers=(1, 2, 3))
    (tmp_path / "scans").mkdir()
    for number in (0, 1, 2):
        trimesh.creation.box((0.5, 0.4, 1.7)).export(tmp_path / "scans" / f"body{number:04d}.{ending}")
    found = imported(tmp_path, tmp_path / "ours")
    assert "left: 1 scans of other frames: 0" in found.notes
    scan = open_capture(tmp_path / "ours").frame(2).scan
    np.testing.assert_allclose(np.ptp(scan.vertices, axis=0), [0.5, 0.4, 1.7], atol=1e-6)


def test_scans_of_no_frame_are_refused_with_the_numbers_of_both(tmp_path):
    rig(tmp_path, numbers=(1, 2, 3))
    (tmp_path / "scans").mkdir()
    with pytest.raises(UserError, match=r"scans: no scan of the frames 1-3: no \.ply, .* with a number"):
        read_rig("lists", tmp_path, Options())
    (tmp_path / "scans" / "body101.ply").write_bytes(b"")
    with pytest.raises(UserError, match=r"scans: no scan of the frames 1-3: its numbers are 101"):
        read_rig("lists", tmp_path, Options())


def test_the_only_scan_of_the_only_frame_needs_no_number(tmp_path):
    import trimesh

    their = tmp_path / "their"
    rig(their, "{camera}.jpg", numbers=(0,))
    (their / "scans").mkdir()
    trimesh.creation.box((0.5, 0.4, 1.7)).export(their / "scans" / "body.obj")
    imported(their, tmp_path / "ours")
    assert np.ptp(open_capture(tmp_path / "ours").frame(0).scan.vertices, axis=0)[2] == pytest.approx(1.7)
    trimesh.creation.box((0.5, 0.4, 1.7)).export(their / "scans" / "other.obj")
    with pytest.raises(UserError, match=r"scans: no scan of the frames 0: no \.ply, .* with a number"):
        read_rig("lists", their, Options())
