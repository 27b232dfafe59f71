"""A run's store: what is written comes back to the bit, lazily, and what is damaged is named in one line."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zarr

import toile
from tests.support.stored import cut, flip, lose
from toile.errors import UserError
from toile.io.layout import DOUBTFUL, GOOD, LAYOUT, layout_of
from toile.io.run import FrameArray, open_run
from toile.io.run_folder import write_diagnostics
from toile.io.run_writer import RunWriter, copy_store
from toile.scene import BodyModel, Dressed, Garment, GarmentTemplate, Inner, Person, Scene, Segmented, Tracked

FRAMES = (3, 4, 7)
K, Q, G = 3, 2, 5
SCENE = Scene("small", 25.0, "m", "y", "body.npz", {"skin": 1, "vest": 2}, (Garment("vest", "vest.obj", "vest"),), True)


def tetrahedron():
    """A body model of four vertices, three joints and two facial keypoints."""
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    F = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    return BodyModel(
        V, F, V[:K], np.array([-1, 0, 1]), np.array([[0], [1], [2], [2]]), np.ones((4, 1)), np.zeros((4, 3, 1)),
        np.zeros((K, 3, 1)), ("root", "hip", "knee"), uv=V[:, :2], f_uv=F,
        keypoint_names=("body.hip", "face.nose", "face.chin"), keypoint_joint=np.array([1, 2, 2]),
        keypoint_vertices=((), (), ()),
    )  # fmt: skip


def vest():
    rng, F = np.random.default_rng(1), np.array([[0, 1, 2], [2, 3, 4]], np.int32)
    loops = np.array([0, 1, 2], np.int32), np.array([3, 4], np.int32)
    skin = rng.dirichlet(np.ones(K), G)
    return GarmentTemplate("vest", 2, rng.normal(size=(G, 3)), F, rng.random((6, 2)), F, skin, loops, ("neck", "hem"))


def frame_of(seed):
    """(Tracked, Segmented, Dressed by garment, Inner) of random values."""
    rng = np.random.default_rng(seed)

    def confidence(n):
        return rng.integers(0, 3, n).astype(np.uint8)

    tracked = Tracked(
        rng.normal(size=(4, 3)), rng.normal(size=(K, 3)), rng.normal(size=3), rng.normal(size=(Q, 3)), confidence(4),
        {"rms": 0.5 * seed},
    )  # fmt: skip
    nothing = np.zeros(0)
    segmented = Segmented(rng.integers(0, 3, 4).astype(np.uint8), nothing, nothing, nothing, {})
    dressed = {"vest": Dressed(np.zeros((G, 3)), confidence(G), {})}
    return (
        tracked,
        segmented,
        dressed,
        Inner(rng.normal(size=(4, 3)), confidence(4), {"vest": rng.random((G, 3))}, 0, {}),
    )


@pytest.fixture
def run(tmp_path):
    """Frames 3 and 7 registered, frame 4 failed; its body model lies in the capture alone."""
    folder, capture, model = tmp_path / "run", tmp_path / "capture", tetrahedron()
    folder.mkdir()
    capture.mkdir()
    (folder / "config.toml").write_text(f"capture = {json.dumps(str(capture))}\n")
    names = [name for name in model.keypoint_names]
    np.savez(
        capture / "body.npz", v_template=model.v_template, f=model.f, J=model.J, parents=model.parents,
        weights_idx=model.weights_idx, weights_val=model.weights_val, shapedirs=model.shapedirs,
        J_shapedirs=model.J_shapedirs, joint_names=np.array(model.joint_names), uv=model.uv, f_uv=model.f_uv,
        keypoint_names=np.array(names), keypoint_joint=model.keypoint_joint, keypoint_vertices=np.zeros(0, np.int64),
        keypoint_starts=np.zeros(4, np.int64),
    )  # fmt: skip
    writer = RunWriter.create(
        folder, FRAMES, SCENE, model, Person(np.array([0.5]), model.v_template, model.J), [vest()]
    )
    for number in (3, 7):
        writer.write(number, *frame_of(number), verdict=DOUBTFUL if number == 7 else GOOD)
    writer.fail(4)
    return folder


def test_every_array_comes_back_as_it_was_written(run):
    opened, template = open_run(run), vest()
    assert opened.frames.tolist() == list(FRAMES) and opened.done.tolist() == [1, 2, 1] and opened.ok == [3, 7]
    assert (
        opened.rows().tolist() == [0, 2]
        and opened.rows([4, 7]).tolist() == [2]
        and opened.verdict.tolist() == [0, 2, 1]
    )
    assert opened.shape.tolist() == [0.5] and opened.joint_names == ("root", "hip", "knee")
    assert (opened.scene.name, opened.scene.fps, opened.scene.up) == ("small", 25.0, "y")
    garment = opened.garments["vest"]
    for name in ("faces", "uv", "face_uv", "skin"):
        assert np.array_equal(getattr(garment, name), getattr(template, name)), name
    assert garment.label == 2 and {n: loop.tolist() for n, loop in garment.loops.items()} == {
        "neck": [0, 1, 2],
        "hem": [3, 4],
    }
    assert np.array_equal(opened.track.faces, tetrahedron().f) and np.array_equal(opened.inner.faces, tetrahedron().f)
    for row, number in ((0, 3), (2, 7)):
        tracked, segmented, dressed, inner = frame_of(number)
        written = {
            opened.track.vertices: tracked.vertices, opened.pose.rotations: tracked.rotations,
            opened.pose.translation: tracked.translation, opened.face: tracked.face, opened.labels: segmented.vertices,
            opened.inner.vertices: inner.vertices, garment.vertices: inner.garments["vest"],
            opened.confidence["track"]: tracked.confidence, opened.confidence["inner"]: inner.confidence,
            opened.confidence["vest"]: dressed["vest"].confidence,
        }  # fmt: skip
        for array, values in written.items():
            for found in (array[row], array.at(number), array[:][row], array[[row]][0], array[row:][0]):
                assert found.dtype == values.dtype and np.array_equal(found, values)
    assert np.isnan(opened.track.at(4)).all() and np.isnan(opened.pose.at(4)[0]).all()


def test_a_mask_of_frames_gives_the_rows_where_it_is_true(run):
    opened = open_run(run)
    good = opened.done == 1
    for mask in (good, good.tolist()):
        assert np.array_equal(opened.track.vertices[mask], opened.track.vertices[[0, 2]])
    assert opened.track.vertices[opened.frames == 5].shape == (0, *opened.track.vertices.shape[1:])


@pytest.mark.parametrize("rows", [(0, 2), True, [True], np.ones(4, bool), [0.7], 1.0, [[0, 1]], "0", [3], -4])
def test_what_are_no_rows_of_frames_is_an_index_error(run, rows):
    with pytest.raises(IndexError):
        open_run(run).track.vertices[rows]


def test_an_older_store_has_no_verdict(run):
    del zarr.open_group(str(run / "registered.zarr"), mode="r+")["verdict"]
    assert open_run(run).verdict is None


def test_the_store_is_laid_out_as_the_table_says(run):
    group = zarr.open_group(str(run / "registered.zarr"), mode="r")
    sizes = {"T": 3, "n": 4, "m": 4, "K": K, "S": 1, "q": Q, "g": G, "f": 2, "t": 6}
    table = layout_of(["vest"], True)
    assert len(table) == len(LAYOUT) and group.metadata.zarr_format == 3 and group.attrs["version"] == 2
    assert {n for n, a in group.members(max_depth=None) if isinstance(a, zarr.Array)} == set(table)
    for key, (stored, _) in table.items():
        shape = tuple(int(sizes.get(axis, axis)) for axis in stored.axes.split())
        assert (group[key].shape, str(group[key].dtype)) == (shape, stored.dtype), key
        assert group[key].chunks == ((1, *shape[1:]) if stored.per_frame else shape), key


def test_the_page_of_the_format_names_every_array_with_its_shape_and_type():
    page = (Path(__file__).parents[2] / "docs" / "formats" / "run.md").read_text(encoding="utf-8")
    for key, stored in LAYOUT.items():
        axes = stored.axes.split()
        shape = f"({','.join(axes)}{',' if len(axes) == 1 else ''})"
        assert f"| `{key}` | {shape} | {stored.dtype} |" in page, key


def test_opening_reads_no_frame(run):
    for path in (run / "registered.zarr").rglob("c/*"):
        if path.is_file() or path.parent.name == "c":
            damaged = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
            for chunk in damaged:
                chunk.write_bytes(b"")
    opened = open_run(run)
    assert opened.track.vertices.shape == (3, 4, 3) and set(opened.garments) == {"vest"}
    with pytest.raises(UserError):
        opened.row(3)


def test_a_store_without_a_version_is_of_the_first_and_another_is_refused(run):
    group = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    before = open_run(run).track.at(7)
    del group.attrs["version"]
    assert np.array_equal(open_run(run).track.at(7), before)
    group.attrs["version"] = 3
    with pytest.raises(UserError, match=r"run/registered.zarr: version 3 of the layout, expected 2 or 1$"):
        open_run(run)


@pytest.mark.parametrize(
    "harm, key, read, said",
    [
        (flip, "track/vertices", lambda r: r.track.at(7), "track/vertices: frame 7: cannot be read"),
        (flip, "track/vertices", lambda r: r.track.vertices[:], "track/vertices: frame 7: cannot be read"),
        (cut, "pose/rotations", lambda r: r.pose.rotations[:], "pose/rotations: frame 3: cannot be read"),
        (cut, "done", lambda r: r.ok, "done: frame 3: cannot be read"),
        (cut, "garment/vest/skin", lambda r: r.garments["vest"].skin, "garment/vest/skin: cannot be read"),
    ],
    ids=["one frame", "one of all", "all frames", "done", "fixed"],
)
def test_a_changed_frame_and_a_cut_file_are_named_by_array_and_frame(run, harm, key, read, said):
    harm(run, key, 2)
    with pytest.raises(UserError, match=f"run/registered.zarr: {said}") as caught:
        read(open_run(run))
    assert "\n" not in str(caught.value)


def test_a_flipped_frame_harms_no_other_of_its_file(run):
    flip(run, "inner/vertices", 2)
    assert np.isfinite(open_run(run).inner.at(3)).all() and list(open_run(run).damaged(FRAMES)) == [7]


def test_a_lost_file_of_registered_frames_is_no_frame_of_nan(run):
    lose(run, "inner/vertices", 2)
    opened = open_run(run)
    for read in (lambda: opened.inner.at(7), lambda: opened.inner.vertices[[1, 2]], lambda: opened.inner.vertices[2:]):
        with pytest.raises(UserError, match="inner/vertices: frame 7: its chunk is missing$"):
            read()
    assert np.isnan(opened.inner.at(4)).all() and list(opened.damaged(FRAMES)) == [3, 7]


@pytest.mark.parametrize("harm", [flip, cut, lose])
@pytest.mark.parametrize("key", ["inner/vertices", "labels"])
def test_damaged_frames_are_written_again_and_the_others_stay(run, key, harm):
    before = {name: array[...] for name, array in arrays_of(run)}
    harm(run, key, 2)
    lost = tuple(open_run(run).damaged(FRAMES))
    writer = RunWriter.of(run)
    writer.reopen(lost)
    assert writer.pending(FRAMES) == lost == ((7,) if harm is flip else (3, 7))
    with writer.together():
        for number in lost:
            writer.write(number, *frame_of(number), verdict=DOUBTFUL if number == 7 else GOOD)
    after = {name: array[...] for name, array in arrays_of(run)}
    if harm is flip:
        assert all(np.array_equal(before[n], after[n], equal_nan=before[n].dtype.kind == "f") for n in before)
    assert not open_run(run).damaged(FRAMES)


def arrays_of(run):
    group = zarr.open_group(str(run / "registered.zarr"), mode="r")
    return [(name, item) for name, item in group.members(max_depth=None) if isinstance(item, zarr.Array)]


def test_frames_that_share_files_are_grouped_and_written_together_to_the_same_bytes(run, tmp_path):
    writer = RunWriter.of(run)
    assert writer.groups((3, 7)) == [(3, 7)]
    files = {p: p.read_bytes() for p in (run / "registered.zarr").rglob("*") if p.is_file()}
    with writer.together():
        for number in (7, 3):
            writer.write(number, *frame_of(number), verdict=DOUBTFUL if number == 7 else GOOD)
    arrays = {name: array[...] for name, array in arrays_of(run)}
    for path, data in files.items():
        path.write_bytes(data)
    for name, array in arrays_of(run):
        assert np.array_equal(array[...], arrays[name], equal_nan=array.dtype.kind == "f"), name


def test_many_frames_lie_in_few_files(tmp_path):
    """What 120 frames of a run take: three files an array, not 120."""
    (tmp_path / "run").mkdir()
    person = Person(np.array([0.5]), tetrahedron().v_template, tetrahedron().J)
    writer = RunWriter.create(tmp_path / "run", range(120), SCENE, tetrahedron(), person, [vest()])
    assert [len(group) for group in writer.groups(range(120))] == [50, 50, 20]
    for group in writer.groups(range(120)):
        with writer.together():
            for number in group:
                writer.write(number, *frame_of(number))
    for key, (stored, _) in layout_of(["vest"], True).items():
        found = [p for p in (tmp_path / "run" / "registered.zarr" / key / "c").rglob("*") if p.is_file()]
        assert len(found) == (3 if stored.per_frame else 1), key
    for number in (0, 49, 50, 119):
        assert np.array_equal(open_run(tmp_path / "run").track.at(number), frame_of(number)[0].vertices)


def test_a_store_of_a_file_a_frame_is_gone_on_with(run):
    """As older versions made them."""
    group = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    for key, (stored, _) in layout_of(["vest"], True).items():
        if stored.per_frame:
            values = group[key][...]
            group.create_array(key, data=values, chunks=(1, *values.shape[1:]), overwrite=True)
    writer = RunWriter.of(run)
    assert writer.groups((3, 7)) == [(3,), (7,)]
    writer.reopen((7,))
    with writer.together():
        writer.write(7, *frame_of(9))
    assert np.array_equal(open_run(run).track.at(7), frame_of(9)[0].vertices)
    assert np.array_equal(open_run(run).track.at(3), frame_of(3)[0].vertices)


def test_a_missing_array_is_named(run):
    group = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    del group["confidence/inner"]
    with pytest.raises(UserError, match=r"run/registered.zarr: confidence/inner is missing$"):
        open_run(run).inner.confidence.at(3)


@pytest.mark.parametrize(
    "text, said",
    [
        ("{", "cannot be read"),
        ('{"zarr_format": 3, "node_type": "group"}', "scene: Field required"),
        ('{"zarr_format": 3, "node_type": "group", "attributes": {"scene": 3, "joint_names": []}}', "scene: Input"),
    ],
    ids=["no JSON", "no attributes", "no scene"],
)
def test_a_store_that_is_none_is_refused_in_one_line(run, text, said):
    (run / "registered.zarr" / "zarr.json").write_text(text)
    with pytest.raises(UserError, match=f"run/registered.zarr: {said}") as caught:
        open_run(run)
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_store_is_no_run(tmp_path):
    with pytest.raises(UserError, match="no registered.zarr"):
        open_run(tmp_path)


def test_a_frame_that_is_not_there_is_named(run):
    with pytest.raises(UserError, match="run: frame 5 is not in the run$"):
        open_run(run).track.at(5)


def test_the_captures_own_body_model_is_found_from_any_folder(run, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    opened = open_run(run)
    assert np.array_equal(opened.body_model.v_template, tetrahedron().v_template)
    assert np.array_equal(opened.rest_joints, tetrahedron().J) and opened.body_model is opened.body_model


def test_a_body_model_that_leaves_the_capture_or_does_not_fit_is_refused(run, tmp_path):
    group = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    (tmp_path / "capture" / "body.npz").rename(tmp_path / "other.npz")
    group.attrs["body_model"] = "../other.npz"
    with pytest.raises(UserError, match="leaves the capture"):
        open_run(run).rest_joints.sum()
    group.attrs["body_model"] = "anny"
    with pytest.raises(UserError, match="do not fit the body model anny"):
        open_run(run).rest_joints.sum()


def test_diagnostics_come_back_by_stage_and_by_frame(run):
    write_diagnostics(run, 3, {"track": {"rms": 1.5}})
    assert not open_run(run).diagnostics and open_run(run).diagnostics.at(3) == {"track": {"rms": 1.5}}
    writer = RunWriter.of(run)
    assert not writer.whole
    writer.write_diagnostics({3: {"track": {"rms": 1.5}}, 7: {"dress.vest": {"turns": 2}}})
    found = open_run(run).diagnostics
    assert writer.whole and set(found) == {"dress.vest", "track"} and open_run(run).diagnostics.at(7) == {}
    assert np.array_equal(found["track"]["rms"], [1.5, np.nan, np.nan], equal_nan=True)
    assert np.array_equal(found["dress.vest"]["turns"], [np.nan, np.nan, 2.0], equal_nan=True)


def test_failed_frames_are_given_again(run):
    writer = RunWriter.of(run)
    writer.write_diagnostics({})
    assert writer.pending(FRAMES) == ()
    writer.reopen([4])
    assert writer.pending(FRAMES) == (4,) and not writer.whole and open_run(run).ok == [3, 7]


def test_a_run_without_garments_or_face_has_neither(tmp_path):
    model, folder = tetrahedron(), tmp_path / "bare"
    folder.mkdir()
    bare = replace(SCENE, garments=(), face_keypoints=False, body_model="anny")
    writer = RunWriter.create(folder, FRAMES, bare, model, Person(np.zeros(0), model.v_template, model.J))
    writer.write(3, frame_of(3)[0])
    opened = open_run(folder)
    assert opened.inner is None and opened.garments == {} and opened.face is None and opened.labels is None
    assert list(opened.confidence) == ["track"] and opened.body is opened.track and len(opened.shape) == 0
    assert np.array_equal(opened.body.at(3), frame_of(3)[0].vertices)


def test_a_copy_differs_where_it_was_changed_and_appears_whole(run, tmp_path):
    def change(writer):
        assert not (tmp_path / "copy" / "registered.zarr").exists()
        writer.write_garment(7, "vest", np.ones((G, 3)), np.full(G, 1, np.uint8))

    copy_store(open_run(run), tmp_path / "copy", change)
    before, after = open_run(run), open_run(tmp_path / "copy")
    assert (after.garments["vest"].at(7) == 1).all() and (after.confidence["vest"].at(7) == 1).all()
    assert np.array_equal(after.garments["vest"].at(3), before.garments["vest"].at(3))
    assert np.array_equal(after.inner.vertices[:], before.inner.vertices[:], equal_nan=True)


def test_another_process_opens_its_own(run):
    import pickle

    opened = pickle.loads(pickle.dumps(open_run(run)))
    assert np.array_equal(opened.track.at(7), frame_of(7)[0].vertices)


def test_reading_a_run_needs_no_torch(run):
    code = (
        "import sys; sys.modules['torch'] = None\n"
        f"import toile; run = toile.open_run({str(run)!r})\n"
        "print(run.track.at(7).shape, run.garments['vest'].faces.shape, run.body_model.joint_names)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(4, 3) (2, 3) ('root', 'hip', 'knee')"
    assert toile.open_run is open_run and isinstance(open_run(run).face, FrameArray)
