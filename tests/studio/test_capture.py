import hashlib
import json

import numpy as np
import pytest

from toile.scene import CaptureError
from toile.studio.make import StudioOptions, make_capture

TINY = dict(frames=2, cameras=2, size=96, seed=3, scan_faces=4000)


def digest(folder):
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return [(str(p.relative_to(folder)), hashlib.sha256(p.read_bytes()).hexdigest()) for p in files]


@pytest.mark.parametrize(
    "bad",
    [
        {"frames": 0}, {"cameras": -1}, {"size": 8}, {"seed": -1}, {"noise": float("nan")}, {"holes": 1.5},
        {"label_errors": -0.1}, {"subject": "naked"}, {"motion": "swim"}, {"renderer": "mitsuba"}, {"scan_faces": 0},
    ],
)  # fmt: skip
def test_options_out_of_range_are_refused_by_name(bad):
    with pytest.raises(CaptureError, match=next(iter(bad))):
        StudioOptions(**bad)


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    pytest.importorskip("anny")
    pytest.importorskip("open3d")
    out = tmp_path_factory.mktemp("studio") / "bare"
    steps = []
    report = make_capture(out, StudioOptions(garment=None, **TINY), lambda *a: steps.append(a))
    return out, report, steps


def test_a_bare_capture_holds_the_layout_and_no_garment(bare):
    import tomllib

    import zarr
    from PIL import Image

    out, report, steps = bare
    scene = tomllib.loads((out / "scene.toml").read_text())
    assert "garment" not in scene and "tshirt" not in scene["labels"]
    assert not (out / "templates").exists()
    frame = out / "frames" / "000001"
    label = np.asarray(Image.open(frame / "labels" / "cam01.png"))
    mask = np.asarray(Image.open(frame / "masks" / "cam01.png"))
    assert label.shape == (96, 96) and np.array_equal(label > 0, mask > 0) and not (label == 3).any()
    names = json.loads((frame / "keypoints.json").read_text())["names"]
    assert {n.split(".")[0] for n in names} == {"body", "face", "hand_left", "hand_right"}
    truth = zarr.open_group(str(out / "truth" / "truth.zarr"), mode="r")
    assert truth["body/vertices"].shape == (2, 13718, 3) and "garment" not in truth
    assert truth["pose/rotations"].shape == (2, 104, 3) and truth.attrs["seed"] == report.seed
    assert steps[-1][1] == steps[-1][2]


def test_pose_and_joints_of_the_truth_agree(bare):
    import zarr

    truth = zarr.open_group(str(bare[0] / "truth" / "truth.zarr"), mode="r")
    names = truth.attrs["joint_names"]
    assert len(names) == truth["joints"].shape[1]
    wrist = truth["joints"][0, names.index("wrist.L")]
    near = np.linalg.norm(truth["body/vertices"][0] - wrist, axis=1).min()
    assert near < 0.05


def test_same_seed_same_bits(bare, tmp_path):
    make_capture(tmp_path / "again", StudioOptions(garment=None, **TINY))
    assert digest(tmp_path / "again") == digest(bare[0])


def test_an_existing_folder_is_refused_and_left_alone(bare):
    before = digest(bare[0])
    with pytest.raises(CaptureError, match="exists already"):
        make_capture(bare[0], StudioOptions(garment=None, **TINY))
    assert digest(bare[0]) == before


def test_a_failed_capture_leaves_nothing_behind(tmp_path, monkeypatch, body):
    from toile.studio import make

    monkeypatch.setattr(make, "write_capture", lambda *a: 1 / 0)
    monkeypatch.setattr(make, "accepted_truth", lambda *a: (None, make.StudioReport(tmp_path, 0)))
    with pytest.raises(ZeroDivisionError):
        make_capture(tmp_path / "x", StudioOptions(garment=None, **TINY))
    assert list(tmp_path.iterdir()) == []


def test_a_discarded_seed_is_counted_and_replaced(monkeypatch):
    from toile.studio import make
    from toile.studio.sequence import Truth
    from toile.studio.truth import TruthRejected

    seen = []

    def truth(options, seed, progress):
        seen.append(seed)
        if len(seen) < 3:
            raise TruthRejected("frame 0: no")
        return Truth(*[None] * 8, per_frame=[], figures={})

    monkeypatch.setattr(make, "make_truth", truth)
    _, report = make.accepted_truth(StudioOptions(seed=7), lambda *a: None)
    assert len(report.rejected) == 2 and report.rejected[0].startswith("seed 7: frame 0")
    assert report.seed == seen[2] and len(set(seen)) == 3


@pytest.mark.slow
def test_a_clothed_capture_slides_and_never_intersects(tmp_path):
    pytest.importorskip("newton")
    import zarr

    from toile.studio.body import make_body
    from toile.studio.truth import pairs_between

    report = make_capture(tmp_path / "c", StudioOptions(motion="talk", **TINY))
    assert report.figures["strain_p99"] < 0.2 and report.figures["clearance_min_mm"] > 1
    truth = zarr.open_group(str(tmp_path / "c" / "truth" / "truth.zarr"), mode="r")
    g = truth["garment/tshirt"]
    faces = make_body("fitted", np.random.default_rng([report.seed, 0])).skin_faces
    for k in range(2):
        V = truth["body/vertices"][k].astype(np.float64)
        assert pairs_between(V, faces, g["vertices"][k].astype(np.float64), g["faces"][:]) == 0
    assert g["map_face"].shape[0] == g["map_bary"].shape[0] == sum(
        line.startswith("v ") for line in (tmp_path / "c" / "templates" / "tshirt.obj").open()
    )
