import hashlib
import json

import numpy as np
import pytest

from toile.errors import UserError
from toile.studio.make import StudioOptions, make_capture

TINY = dict(frames=2, cameras=2, size=96, seed=3, scan_faces=4000)


def digest(folder):
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return [(str(p.relative_to(folder)), hashlib.sha256(p.read_bytes()).hexdigest()) for p in files]


@pytest.mark.parametrize(
    "bad",
    [
        {"frames": 0}, {"cameras": -1}, {"size": 8}, {"seed": -1}, {"scan_noise": float("nan")}, {"hole_share": 1.5},
        {"label_error_share": -0.1}, {"subject": "naked"}, {"motion": "swim"}, {"renderer": "oils"}, {"scan_faces": 0},
        {"pixel_paths": 0}, {"image_step": 0}, {"span": float("nan")}, {"motion": "talk+swim"},
        {"frames": 59, "motion": "talk+rom"},
    ],
)  # fmt: skip
def test_options_out_of_range_are_refused_by_name(bad):
    with pytest.raises(UserError, match=next(iter(bad))):
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
    with pytest.raises(UserError, match="exists already"):
        make_capture(bare[0], StudioOptions(garment=None, **TINY))
    assert digest(bare[0]) == before


def test_a_capture_that_was_begun_with_other_options_is_refused(tmp_path):
    from toile.studio import make

    (tmp_path / "x.part" / "work").mkdir(parents=True)
    make.begin(tmp_path / "x.part", StudioOptions(**TINY))
    with pytest.raises(UserError, match="x.part: was begun with frames 2, not 3"):
        make_capture(tmp_path / "x", StudioOptions(**TINY | {"frames": 3}))
    kept = tmp_path / "x.part" / "work" / "options.json"
    begun = json.loads(kept.read_text())
    del begun["options"]["trousers"]  # begun before there was such an option
    kept.write_text(json.dumps(begun))
    assert not make.begin(tmp_path / "x.part", StudioOptions(**TINY))
    with pytest.raises(UserError, match="begun with trousers False, not True"):
        make.begin(tmp_path / "x.part", StudioOptions(**TINY, trousers=True))
    (tmp_path / "y.part" / "frames").mkdir(parents=True)
    with pytest.raises(UserError, match="y.part: is in the way"):
        make_capture(tmp_path / "y", StudioOptions(**TINY))
    assert not (tmp_path / "x").exists() and not (tmp_path / "y").exists()


def test_bad_input_found_late_leaves_nothing_behind(tmp_path):
    pytest.importorskip("anny")
    with pytest.raises(UserError, match="missing.bvh"):
        make_capture(tmp_path / "x", StudioOptions(garment=None, motion=str(tmp_path / "missing.bvh"), **TINY))
    assert list(tmp_path.iterdir()) == []


class Killed(BaseException):
    pass


STEPPED = dict(frames=4, cameras=2, size=64, seed=3, scan_faces=4000, garment="cut", motion="talk", image_step=3)


@pytest.fixture(scope="module")
def hasty():
    """Short preludes before the captured frames."""
    pytest.importorskip("newton")
    from toile.studio import garment, motion

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(garment, "SETTLING", 1)
        patch.setattr(motion, "RAMP", 2)
        yield


@pytest.fixture(scope="module")
def stepped(hasty, tmp_path_factory):
    out = tmp_path_factory.mktemp("studio") / "stepped"
    make_capture(out, StudioOptions(**STEPPED), workers=2)
    return out


@pytest.mark.slow(seconds=60)
def test_a_capture_that_is_killed_twice_ends_with_the_same_bits(stepped, tmp_path, monkeypatch):
    from toile.studio import sequence

    monkeypatch.setattr(sequence, "BLOCK", 2)
    for moment in (("simulate", 3), ("frames", 1)):

        def kill(step, done, total):
            if (step, done) == moment:
                raise Killed

        with pytest.raises(Killed):
            make_capture(tmp_path / "x", StudioOptions(**STEPPED), kill)
        assert [p.name for p in tmp_path.iterdir()] == ["x.part"]
    make_capture(tmp_path / "x", StudioOptions(**STEPPED))
    assert digest(tmp_path / "x") == digest(stepped)
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


@pytest.mark.slow(seconds=60)
def test_every_third_frame_is_captured_under_its_simulated_number(stepped):
    import zarr

    from toile.io.capture import open_capture
    from toile.pipeline.plan import plan

    capture = open_capture(stepped)
    assert capture.frames == (0, 3) and capture.scene.fps == 30
    assert [s.stage for s in plan(capture) if s.runs][-3:] == ["inner", "face", "view"]
    truth = zarr.open_group(str(stepped / "truth" / "truth.zarr"), mode="r")
    assert list(truth["frames"][:]) == [0, 1, 2, 3]
    assert truth["garment/tshirt/vertices"].shape[0] == len(truth.attrs["per_frame"]) == 4
    V, joints = truth["body/vertices"][3], truth["joints"][3]
    wrist = joints[truth.attrs["joint_names"].index("wrist.L")]
    assert np.linalg.norm(V - wrist, axis=1).min() < 0.05


@pytest.mark.slow(seconds=45)
def test_frames_between_the_pictured_ones_have_keypoints_alone_and_change_no_other_frame(stepped, tmp_path):
    from toile.io.capture import open_capture

    make_capture(tmp_path / "x", StudioOptions(**STEPPED, between=True))
    capture = open_capture(tmp_path / "x")
    assert capture.frames == (0, 1, 2, 3)
    assert [bool(capture.pictured(n)) for n in capture.frames] == [True, False, False, True]
    assert [file.name for file in (tmp_path / "x" / "frames" / "000001").iterdir()] == ["keypoints.json"]
    for n in (0, 3):
        own, other = (digest(place / "frames" / f"{n:06d}") for place in (tmp_path / "x", stepped))
        assert own == other
    near, between = (np.stack(list(capture.keypoints(n).points.values())) for n in (0, 1))
    both = (near[..., 2] > 0.5) & (between[..., 2] > 0.5)
    assert capture.keypoints(0).names == capture.keypoints(1).names and both.mean() > 0.3
    moved = np.linalg.norm(near[both][:, :2] - between[both][:, :2], axis=1)
    assert 0 < np.median(moved) < 5  # of 64 pixels; noise is 2


def test_a_discarded_seed_is_counted_and_replaced(tmp_path, monkeypatch):
    from toile.studio import make
    from toile.studio.truth import TruthRejected

    seen = []

    class Twice:
        def __init__(self, folder, options, seed):
            folder.mkdir(exist_ok=True)
            seen.append(seed)

        def simulate(self, progress):
            if len(seen) < 3:
                raise TruthRejected("frame 0: no")

    monkeypatch.setattr(make, "Sequence", Twice)
    report, folder = make.accepted_sequence(tmp_path, StudioOptions(seed=7), None)
    assert len(report.rejected) == 2 and report.rejected[0].startswith("seed 7: frame 0")
    assert report.seed == seen[2] and len(set(seen)) == 3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["attempt2", "rejected.json"]
    assert make.accepted_sequence(tmp_path, StudioOptions(seed=7), None)[0].rejected == report.rejected


def test_where_every_seed_is_discarded_the_reasons_and_what_to_change_are_said(tmp_path, monkeypatch):
    from toile.studio import make
    from toile.studio.truth import TruthRejected

    class Never:
        def __init__(self, folder, options, seed):
            folder.mkdir()

        def simulate(self, progress):
            raise TruthRejected("frame 3: tshirt: no")

    monkeypatch.setattr(make, "Sequence", Never)
    with pytest.raises(UserError, match=r"5 seeds was discarded \(seed 7: frame 3: tshirt: no; .*another --seed"):
        make.accepted_sequence(tmp_path, StudioOptions(seed=7), None)


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
    assert (
        g["map_face"].shape[0]
        == g["map_bary"].shape[0]
        == sum(line.startswith("v ") for line in (tmp_path / "c" / "templates" / "tshirt.obj").open())
    )


@pytest.mark.slow
def test_a_shirt_over_trousers_is_a_scene_of_two_garments_that_never_intersect(tmp_path):
    pytest.importorskip("newton")
    import zarr
    from PIL import Image

    from toile.io.capture import open_capture
    from toile.studio.truth import pairs_between

    make_capture(tmp_path / "c", StudioOptions(motion="talk", garment="cut", trousers=True, **TINY))
    capture = open_capture(tmp_path / "c")
    assert [g.name for g in capture.scene.garments] == ["trousers", "tshirt"]  # inner to outer
    truth = zarr.open_group(str(tmp_path / "c" / "truth" / "truth.zarr"), mode="r")
    legs, shirt = (truth[f"garment/{name}"] for name in ("trousers", "tshirt"))
    for k in range(2):
        T, V = legs["vertices"][k].astype(np.float64), shirt["vertices"][k].astype(np.float64)
        assert pairs_between(T, legs["faces"][:], V, shirt["faces"][:]) == 0
        assert V[:, 2].min() < T[:, 2].max() - 0.05  # the waist is covered
    assert not (truth["labels"][:] == capture.scene.labels["trousers"]).any()  # the body under them is skin
    for group in (legs, shirt):
        assert group["map_face"].shape[0] == len(capture.templates[group.basename].vertices)
    seen = np.unique(np.asarray(Image.open(tmp_path / "c" / "frames" / "000001" / "labels" / "cam01.png")))
    assert {capture.scene.labels["trousers"], capture.scene.labels["tshirt"]} <= set(seen.tolist())
