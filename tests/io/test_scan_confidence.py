"""The property `confidence` of scan.ply: written and read, refused where it is none."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.mesh import read_mesh, write_mesh
from toile.scene import Mesh

V = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
F = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def test_confidence_and_labels_come_back(tmp_path):
    mesh = Mesh(V, F, face_labels=np.array([3, 0], np.uint8), confidence=np.array([0, 0.25, 0.5, 1]))
    write_mesh(tmp_path / "scan.ply", mesh)
    read = read_mesh(tmp_path / "scan.ply")
    assert read.confidence.tolist() == [0, 0.25, 0.5, 1] and read.face_labels.tolist() == [3, 0]
    assert np.array_equal(read.vertices, V) and np.array_equal(read.faces, F)


def test_a_scan_without_confidence_has_none(tmp_path):
    write_mesh(tmp_path / "scan.ply", Mesh(V, F))
    assert read_mesh(tmp_path / "scan.ply").confidence is None


@pytest.mark.parametrize("bad", [np.nan, -0.1, 200])
def test_confidence_that_is_none_is_refused(tmp_path, bad):
    mesh = trimesh.Trimesh(V, F, process=False)
    mesh.vertex_attributes["confidence"] = np.array([0.5, bad, 0.5, 0.5], np.float32)
    mesh.export(tmp_path / "scan.ply")
    with pytest.raises(UserError, match="scan.ply: confidence: expected numbers from 0 to 1"):
        read_mesh(tmp_path / "scan.ply")


def test_a_scan_of_which_nothing_counts_is_refused(tmp_path):
    capture = shutil.copytree(Path(__file__).parents[2] / "data_samples" / "tshirt-talk", tmp_path / "capture")
    path = capture / "frames" / "000000" / "scan.ply"
    scan = read_mesh(path)
    write_mesh(path, dataclasses.replace(scan, confidence=np.zeros(len(scan.vertices))))
    with pytest.raises(UserError, match=r"000000/scan.ply: confidence: 0 at every vertex"):
        open_capture(capture).scan(0)
