"""An avatar driven by a motion: what it writes, what it warns of, what it refuses."""

import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import zarr
from PIL import Image

from toile.avatar.drive import apart
from toile.avatar.drive.animate import DrivenAvatar, animate, check_asked, filmed
from toile.avatar.drive.apart import take
from toile.avatar.drive.cameras import camera_path, resized, turned
from toile.avatar.drive.draping import outdated
from toile.avatar.drive.driver import REACH, load_driver, make_track
from toile.avatar.drive.posing import PosedAvatar
from toile.avatar.model.checkpoint import load_avatar
from toile.errors import UserError
from toile.io.export.clip import rest_surface
from toile.io.export.source import open_clip
from toile.io.export.writing import write_clip
from toile.io.mesh import read_mesh
from toile.io.run import open_run
from toile.kernels import intersecting_pairs
from toile.scene import Camera
from toile.surface.apart import keep_apart
from toile.surface.wrapping import Wrapping


@pytest.fixture(scope="module")
def avatar_folder(driven_avatar, tmp_path_factory):
    return shutil.copytree(driven_avatar, tmp_path_factory.mktemp("animated") / "animated")


@pytest.fixture(scope="module")
def made(avatar_folder, sample_run, tmp_path_factory):
    out = tmp_path_factory.mktemp("animated") / "out"
    return out, animate(avatar_folder, sample_run, out, frames=[1, 2], height=64)


def test_it_writes_pictures_meshes_and_a_film(made):
    out, done = made
    assert done.frames == 2
    for kind, suffix in (("pictures", "png"), ("meshes/body", "ply"), ("meshes/tshirt", "ply")):
        assert sorted(p.name for p in (out / kind).iterdir()) == [f"{n:06d}.{suffix}" for n in (1, 2)]
    assert (out / "animation.mp4").stat().st_size > 1000
    picture = np.asarray(Image.open(out / "pictures" / "000001.png"))
    assert (
        picture.shape == (64, 64, 3) and (picture == 255).all(2).mean() > 0.3 and (picture < 250).any(2).mean() > 0.05
    )
    assert json.loads((out / "animation.json").read_text())["intersections_left"] == done.intersections_left


@pytest.fixture(scope="module")
def arm_in(avatar_folder, sample_run, tmp_path_factory):
    """A motion file whose left arm hangs into the hip in its last frame."""
    driven = DrivenAvatar(avatar_folder, sample_run)
    rotations = np.repeat(0 * driven.motion.rotations[:1], 2, axis=0)
    rotations[1, driven.model.joint("upperarm01.L")] = 0, 0.9, 0
    rotations[1, driven.model.joint("lowerarm01.L")] = 0, 0.3, 0
    path = tmp_path_factory.mktemp("motion") / "arm.npz"
    np.savez(path, rotations=rotations, translation=driven.motion.translation[:2], fps=driven.motion.fps)
    return path


def test_limbs_of_a_motion_file_stay_out_of_the_trunk_and_the_record_says_so(avatar_folder, arm_in, tmp_path):
    done = animate(avatar_folder, arm_in, tmp_path / "out", height=64)
    said = json.loads((tmp_path / "out" / "animation.json").read_text())["limbs"]
    assert said == done.limbs and said["pairs_before"] > 10 and said["pairs_left"] == 0
    assert 3 < said["largest_turn_deg"] < 40 and 1 <= said["frames_changed"] <= 2
    given = DrivenAvatar(avatar_folder, arm_in).motion.rotations
    shown = np.stack([open_clip(tmp_path / "out").skeleton.pose(n)[0] for n in (0, 1)])
    assert np.abs(shown - given).max() > 0.05
    as_it_is = take(avatar_folder, arm_in, apart=False)
    assert as_it_is.apart is None and np.array_equal(as_it_is.motion.rotations, given)


def test_limbs_leave_room_for_what_the_layers_of_an_avatar_are_said_to_take(
    avatar_folder, sample_avatar, arm_in, monkeypatch
):
    """As two shirts do; a single layer, which wears nothing, moves as the layers that it is compared with."""
    skin_alone = take(avatar_folder, arm_in, apart=True).apart
    everywhere = lambda skin, faces, worn: Wrapping(np.full(len(skin), 0.02 * len(worn)), np.ones(len(skin), bool))
    monkeypatch.setattr(apart, "wrapping", everywhere)
    layered, single = (take(f, arm_in, apart=True) for f in (avatar_folder, avatar_folder / "baseline"))
    assert layered.apart.angles[1] > 1.2 * skin_alone.angles[1] > 0
    assert np.array_equal(layered.motion.rotations, single.motion.rotations)


def test_the_run_that_taught_an_avatar_drives_it_as_it_is(avatar_folder, sample_run):
    plain, kept = (take(avatar_folder, sample_run, apart=value) for value in (False, True))
    assert kept.apart is None and np.array_equal(plain.motion.rotations, kept.motion.rotations)


def test_a_run_drives_as_it_is_by_its_poses_and_not_by_its_place(avatar_folder, sample_run, tmp_path):
    """`toile train` teaches AVATAR/aligned, and a user drives by the run that this was made of."""
    elsewhere = shutil.copytree(sample_run, tmp_path / "run")
    config, capture = elsewhere / "config.toml", open_run(sample_run).capture.root
    place = tomllib.loads(config.read_text())["capture"]
    config.write_text(config.read_text().replace(f'"{place}"', f'"{capture}"'))
    assert take(avatar_folder, elsewhere, apart=True).apart is None
    poses = zarr.open_group(str(elsewhere / "registered.zarr"), mode="r+")["pose/rotations"]
    poses[1, 3, 0] += 1e-9
    assert take(avatar_folder, elsewhere, apart=True).apart is not None


def test_a_baseline_moves_as_the_avatar_that_it_lies_in(avatar_folder, sample_avatar, arm_in):
    layered, single = (take(f, arm_in, apart=True) for f in (avatar_folder, avatar_folder / "baseline"))
    assert np.array_equal(layered.motion.rotations, single.motion.rotations) and layered.apart.angles.any()


def test_limbs_are_kept_apart_once_for_all_workers_and_with_frames_only_as_far_as_they_reach(
    avatar_folder, arm_in, tmp_path, monkeypatch
):
    asked, said, contents = [], [], []

    def once(*given):
        asked.append(given[-2])
        return keep_apart(*given)

    monkeypatch.setattr(apart, "keep_apart", once)
    for frames, workers in ((None, 1), ([1], 1), ([1], 2)):
        out, hear = tmp_path / f"{frames}{workers}", lambda *at: said.append(at)
        animate(avatar_folder / "baseline", arm_in, out, frames=frames, height=32, workers=workers, progress=hear)
        (surface,) = (out / "meshes").iterdir()
        contents.append((surface / "000001.ply").read_bytes())
    assert len(set(contents)) == 1
    assert asked[0] is None and len(asked) == 3 and asked[1].tolist() == asked[2].tolist() == [True, True]
    assert ("limbs apart", 2, 2) in said and ("collisions of limbs", 2, 2) in said


def test_a_window_is_as_long_in_time_whatever_the_rate_of_the_motion(avatar_folder, sample_run):
    motion = DrivenAvatar(avatar_folder, sample_run).motion
    taught, rows = load_avatar(avatar_folder).scene.fps, np.repeat(np.arange(len(motion)), 2)
    twice = replace(motion, frames=np.arange(len(rows)), rotations=motion.rotations[rows], face=None, fps=2.0 * taught)
    driver, stride, _ = load_driver(avatar_folder)
    with torch.no_grad():
        track = make_track(load_avatar(avatar_folder), twice.frames, twice.rotations, None, 2 * stride, twice.fps)
        wanted = driver.latents(track)["tshirt"]
    assert torch.equal(DrivenAvatar(avatar_folder, twice).latents["tshirt"], wanted)


def test_codes_of_a_frame_are_read_from_the_window_before_it_and_what_smoothing_sees(avatar_folder, sample_run):
    motion = DrivenAvatar(avatar_folder, sample_run).motion
    long = replace(motion, frames=np.arange(40), rotations=np.repeat(motion.rotations[:1], 40, 0), face=None, fps=30.0)
    shown = np.arange(40) == 20
    read = np.flatnonzero(apart.rows_read(avatar_folder, long, {}, False, shown))
    driver, stride, _ = load_driver(avatar_folder)
    smooth, window = int(REACH * 30), (driver.settings.window - 1) * stride
    assert read.tolist() == list(range(20 - smooth - window, 20 + smooth + 1))
    assert apart.rows_read(avatar_folder, long, {}, True, shown)[:21].all()
    faster = np.flatnonzero(apart.rows_read(avatar_folder, replace(long, fps=60.0), {"a": avatar_folder}, False, shown))
    taught = load_avatar(avatar_folder).scene.fps  # the lent garment's window is as long in time
    assert faster[0] == max(20 - int(REACH * 60) - round(window * 60 / taught), 0)
    own = np.flatnonzero(apart.rows_read(avatar_folder, replace(long, fps=60.0), {}, False, shown))
    assert own[0] == faster[0]
    with_track = lambda rotations: driver.latents(
        make_track(load_avatar(avatar_folder), long.frames, rotations, None, stride, 30.0)
    )["tshirt"][20]
    moved = np.array(long.rotations)
    moved[~apart.rows_read(avatar_folder, long, {}, False, shown)] += 0.3
    with torch.no_grad():
        assert torch.equal(with_track(long.rotations), with_track(moved))
    moved[read[0]] += 0.3
    with torch.no_grad():
        assert not torch.equal(with_track(long.rotations), with_track(moved))


def test_an_animation_has_the_same_bits_by_one_process_and_by_two_workers(avatar_folder, sample_run, tmp_path):
    contents, threads = [], torch.get_num_threads()
    for workers in (1, 2):
        torch.set_num_threads(workers + 1)
        out = tmp_path / str(workers) / "out"
        animate(avatar_folder, sample_run, out, frames=[1, 2, 3], height=64, workers=workers)
        contents.append({path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()})
    torch.set_num_threads(threads)
    assert contents[0] == contents[1] and Path("animation.mp4") in contents[0] and len(contents[0]) > 12


def test_the_film_shows_the_frames_in_their_order_in_whichever_they_are_made(made, tmp_path):
    class Film(list):
        add = list.append

    out, _ = made
    shot = SimpleNamespace(
        rows=[0, 1], out=out, size=(64, 64), driven=SimpleNamespace(motion=SimpleNamespace(frames=[1, 2]))
    )
    found = [Film(), Film()]
    for film, order in zip(found, ([0, 1], [1, 0])):
        assert filmed(((row, 0, 0) for row in order), shot, film, lambda *_: None) == {0: [0, 0], 1: [0, 0]}
    assert np.array_equal(*found) and len(found[0]) == 2 and not np.array_equal(*found[0])


def test_the_film_lasts_as_long_as_the_motion_whatever_the_step_of_the_frames(avatar_folder, sample_run, tmp_path):
    av = pytest.importorskip("av")
    animate(avatar_folder, sample_run, tmp_path / "out", frames=[1, 3], height=32, meshes=False)
    with av.open(str(tmp_path / "out" / "animation.mp4")) as film:
        lasts = film.duration / av.time_base
    assert lasts == pytest.approx(2 * 2 / open_run(sample_run).scene.fps, abs=1e-3)  # two pictures of two frames each


def test_no_pair_of_cloth_and_body_is_left(made):
    out, done = made
    body, shirt = (read_mesh(out / "meshes" / name / "000002.ply") for name in ("body", "tshirt"))
    skin = body.faces  # with eyes and tongue, which no shirt meets
    assert done.intersections_left == 0
    assert len(intersecting_pairs(shirt.vertices, shirt.faces, body.vertices, skin)) == 0


def test_the_registered_poses_place_the_body_where_it_was_registered(avatar_folder, sample_run):
    driven = DrivenAvatar(avatar_folder, sample_run)
    decoded, *_ = driven.decode(1, driven.batch(1, driven.avatar.cameras[0]))
    registered = open_run(sample_run).inner.at(1)
    assert np.linalg.norm(decoded["body"].vertices[0].numpy() - registered, axis=1).mean() < 0.02


def of_poses(driven):
    """Its warnings without what its few training frames leave unforetold."""
    return [words for words in driven.warnings if not words.startswith("poses foretell garments badly")]


def test_training_poses_are_near_and_others_are_warned_of(avatar_folder, sample_run, tmp_path):
    assert of_poses(DrivenAvatar(avatar_folder, sample_run)) == []
    rotations = np.zeros((2, 104, 3))
    rotations[:, 1:, 0] = 0.8
    np.savez(tmp_path / "far.npz", rotations=rotations, translation=np.zeros((2, 3)), fps=30.0)
    whole, joint = of_poses(DrivenAvatar(avatar_folder, tmp_path / "far.npz"))
    assert "2 of 2 poses are far from the training's poses: frame 0 is" in whole
    assert "2 of 2 poses have a joint more than 20 degrees from where the training's poses had it" in joint


def test_one_limb_that_no_training_pose_had_is_warned_of(avatar_folder, sample_run, tmp_path):
    """In the mean over all joints such a pose is near."""
    run = open_run(sample_run)
    rotations, translation = (np.repeat(a[None], 2, 0) for a in run.pose.at(1))
    shank = run.body_model.joint_names.index("lowerleg01.R")
    rotations[1, shank, 0] += 0.8
    np.savez(tmp_path / "one.npz", rotations=rotations, translation=translation, fps=30.0)
    (warning,) = of_poses(DrivenAvatar(avatar_folder, tmp_path / "one.npz"))
    assert "1 of 2 poses" in warning and "in frame 1 lowerleg01.R is 4" in warning
    assert of_poses(DrivenAvatar(avatar_folder, tmp_path / "one.npz", frames=[0])) == []  # the other is not shown


def test_frames_that_the_motion_has_not_are_said(avatar_folder, sample_run):
    warned = lambda frames: [
        w for w in DrivenAvatar(avatar_folder, sample_run, frames=frames).warnings if "--frames" in w
    ]
    assert not warned([1, 2]) and not warned(None)
    assert warned([2, 7, 8, 40]) == [
        "--frames: the motion has frames 0 to 3 at 30 a second, of those asked for not 7-8, 40"
    ]


def test_the_baseline_is_driven_by_one_drawn_code(sample_avatar, sample_run):
    first, again, other = (
        DrivenAvatar(sample_avatar / "baseline", sample_run, seed=s).latents["surface"] for s in (0, 0, 1)
    )
    assert (first == again).all() and (first[0] == first[1]).all() and not (first == other).all()


@pytest.mark.parametrize(
    "options, said",
    [
        ({"frames": [77]}, "--frames: the motion has frames 0 to 3"),
        ({"camera": "nobody"}, "--camera nobody: expected orbit"),
        ({"camera": []}, "cameras.json: cameras: there is none"),
        ({"camera": [(1, 1)]}, "--camera, --height: pictures of 1 x 1 pixels, expected at least 2 a side"),
        ({"camera": [(1, 400)], "height": 16}, "pictures of 0 x 16 pixels"),
        ({"camera": [(9000, 100)], "height": 8192}, "737280 x 8192 pixels, .* at most 100000000 pixels in all"),
        ({"garments": {"jacket": "own"}}, "--garment jacket=.*: no garment jacket there: it has tshirt"),
    ],
)
def test_what_does_not_fit_is_refused(avatar_folder, sample_run, tmp_path, tmp_path_factory, options, said):
    if isinstance(options.get("camera"), list):
        K, T = np.diag([50.0, 50, 1]).tolist(), np.eye(4).tolist()
        same = {"K": K, "distortion": [0] * 5, "T_camera_world": T}
        cameras = [{"name": "a", "width": width, "height": height} | same for width, height in options["camera"]]
        file = tmp_path_factory.mktemp("asked") / "cameras.json"
        file.write_text(json.dumps({"cameras": cameras}))
        options = options | {"camera": str(file)}
    if "garments" in options:
        options = {"garments": {"jacket": avatar_folder}}
    with pytest.raises(UserError, match=said):
        animate(avatar_folder, sample_run, tmp_path / "out", **options)
    with pytest.raises(UserError, match=said):  # before any long work
        check_asked(avatar_folder, sample_run, *map(options.get, ("frames", "camera", "height", "garments")))
    assert not list(tmp_path.iterdir())


def test_a_face_of_other_keypoints_is_refused(avatar_folder, sample_run, tmp_path):
    motion = DrivenAvatar(avatar_folder, sample_run).motion
    np.savez(
        tmp_path / "m.npz", rotations=motion.rotations, translation=motion.translation, fps=30.0,
        face=np.zeros((len(motion), 3, 3)),
    )  # fmt: skip
    with pytest.raises(UserError, match=r"m.npz: face is \(4, 3, 3\), expected \(4, 29, 3\)"):
        DrivenAvatar(avatar_folder, tmp_path / "m.npz")


def test_pictures_that_show_nothing_of_the_person_are_said(avatar_folder, sample_run, tmp_path):
    """A motion in centimetres."""
    motion = DrivenAvatar(avatar_folder, sample_run).motion
    places = motion.translation[:2].copy()
    places[1] += 100.0
    np.savez(tmp_path / "m.npz", rotations=motion.rotations[:2], translation=places, fps=motion.fps)
    done = animate(avatar_folder, tmp_path / "m.npz", tmp_path / "out", height=32, meshes=False, apart=False)
    assert any("1 of 2 pictures show nothing of the person, frame 1 first" in words for words in done.warnings)


def test_a_cloth_file_that_is_damaged_is_said_to_be(avatar_folder, tmp_path):
    folder = shutil.copytree(avatar_folder, tmp_path / "avatar")
    (folder / "cloth.tshirt.npz").write_bytes(b"PK")
    (words,) = outdated(folder, load_avatar(folder).layers, None)
    assert "cloth.tshirt.npz: cannot be read: codes drive the garment" in words


def test_a_full_folder_is_left_alone(avatar_folder, sample_run, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(UserError, match="exists already and is not empty"):
        animate(avatar_folder, sample_run, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_an_orbit_turns_the_world_about_the_person():
    T = np.eye(4)
    T[:3, 3] = [0, 0, 3]
    camera = Camera("a", 64, 48, np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), np.zeros(5), T)
    centre, up = np.array([0.1, 0.2, 0.3]), np.array([0, 1.0, 0])
    moved = turned(camera, centre, up, np.pi / 2)
    assert np.allclose(moved.to_camera(centre), camera.to_camera(centre))
    assert np.allclose(np.linalg.norm(moved.centre - centre), np.linalg.norm(camera.centre - centre))
    assert np.allclose(turned(camera, centre, up, 2 * np.pi).T_camera_world, T)
    assert np.allclose(
        resized(camera, 96).project(np.array([[0.1, 0.2, 0]]))[0], 2 * camera.project(np.array([[0.1, 0.2, 0]]))[0]
    )


def test_an_orbit_follows_who_walks_and_lets_him_jump(avatar_folder, sample_run):
    driven = DrivenAvatar(avatar_folder, sample_run)
    there, up = driven.motion.translation.copy(), driven.avatar.up.numpy().astype(float)
    path, level = camera_path(driven, "orbit", 32), np.cross(up, [0.3, 0.5, 0.7])
    seen = [path(i)[0].project(there[i : i + 1])[0] for i in range(4)]
    driven.motion = replace(driven.motion, translation=there + np.arange(4)[:, None] * 5 * level)
    path = camera_path(driven, "orbit", 32)
    away = driven.motion.translation
    assert np.allclose([path(i)[0].project(away[i : i + 1])[0] for i in range(4)], seen)
    driven.motion = replace(driven.motion, translation=there + 0.2 * up)
    path = camera_path(driven, "orbit", 32)
    higher = [path(i)[0].project(there[i : i + 1] + 0.2 * up)[0] for i in range(4)]
    assert np.abs(np.subtract(higher, seen)).max() > 1  # [px]


def test_an_orbit_has_turned_as_far_as_time_has_passed_whatever_the_step_of_the_frames(avatar_folder, sample_run):
    driven = DrivenAvatar(avatar_folder, sample_run)
    motion = driven.motion

    def seen(numbers):
        driven.motion = replace(motion, frames=numbers, translation=np.repeat(motion.translation[:1], len(numbers), 0))
        path = camera_path(driven, "orbit", 32)
        return [path(i)[0].T_camera_world for i in range(len(numbers))]

    every, fifth = seen(7 + np.arange(16)), seen(7 + 5 * np.arange(4))
    assert np.allclose(fifth, every[::5]) and not np.allclose(every[0], every[5])


@pytest.mark.parametrize("up", "xyz")
def test_who_turns_on_the_spot_in_a_bvh_turns_about_the_scene_s_up(avatar_folder, tmp_path, monkeypatch, up):
    path, channels = tmp_path / "turn.bvh", "3 Zrotation Xrotation Yrotation"
    joints = f"ROOT Hips {{ OFFSET 0 0 0 CHANNELS {channels} JOINT Spine {{ OFFSET 0 9 0 CHANNELS {channels} }} }}"
    degrees = "\n".join(f"0 0 {10 * k} 0 0 0" for k in range(10))
    path.write_text(f"HIERARCHY {joints} MOTION Frames: 10 Frame Time: {1 / 30} {degrees}")
    avatar, turn = load_avatar(avatar_folder), np.roll(np.eye(3), "xyz".index(up) - 2, axis=0)
    joints = SimpleNamespace(J=avatar.skeleton.J @ torch.as_tensor(turn.T, dtype=torch.float32))
    turned_avatar = SimpleNamespace(scene=replace(avatar.scene, up=up), skeleton=joints)
    monkeypatch.setattr(apart, "load_avatar", lambda folder: turned_avatar)
    motion = apart.motion_of(avatar_folder, path)
    angles = np.radians(10 * np.arange(10))
    assert np.allclose(motion.rotations[:, 0], angles[:, None] * np.eye(3)["xyz".index(up)])
    assert np.abs(motion.rotations[:, 1:]).max() < 1e-9


def test_a_stopped_animation_leaves_no_folder_that_looks_whole(avatar_folder, sample_run, tmp_path):
    def stop(*_):
        raise KeyboardInterrupt

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        animate(avatar_folder, sample_run, out, frames=[1, 2], height=32, progress=stop)
    assert not out.exists()
    animate(avatar_folder, sample_run, out, frames=[2], height=32)
    assert [p.name for p in (out / "pictures").iterdir()] == ["000002.png"]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_an_animation_is_exported_with_its_skeleton_and_textures(made, tmp_path):
    pytest.importorskip("pxr")
    out, _ = made
    clip = open_clip(out)
    assert clip.frames == (1, 2) and [layer.name for layer in clip.layers] == ["body", "tshirt"] and clip.skinned
    for layer in clip.layers:
        assert np.array_equal(layer.at(2), read_mesh(out / "meshes" / layer.name / "000002.ply").vertices)
        texture = np.asarray(Image.open(layer.texture))
        assert texture.shape == (64, 64, 3) and texture.std() > 5
        assert np.median(rest_surface(clip, layer)[1]) < 0.005
    write_clip(clip, tmp_path / "film.usdc", "usd", "points", lambda *_: None)
    assert sorted(p.name for p in (tmp_path / "film_textures").iterdir()) == ["body.png", "tshirt.png"]


def test_a_posed_avatar_turns_what_it_is_told_to_and_nothing_else(avatar_folder, sample_run):
    posed, driven = PosedAvatar(avatar_folder, sample_run), DrivenAvatar(avatar_folder, sample_run)
    decoded, *_ = driven.decode(1, driven.batch(1, driven.avatar.cameras[0]))
    for name, V in posed.vertices(1, {}).items():
        assert np.abs(V - decoded[name].vertices[0].numpy()).max() < 1e-5
    still, raised = posed.vertices(1, {"head turned": 0.0})["body"], posed.vertices(1, {"left arm up": 0.5})["body"]
    moved, model = np.linalg.norm(raised - still, axis=1), driven.model
    left, right = model.segments["hand_left"], model.segments["hand_right"]
    assert moved[left].min() > 0.03 and moved[right].max() < 0.01 and np.median(moved) < 0.01
    rest = model.joint_transforms(model.J, np.zeros((len(model.J), 3)), np.zeros(3))[1]
    for turn, joint, axis, sign in (  # z up, facing -y
        ("left arm up", "lowerarm01.L", 2, 1),
        ("right arm up", "lowerarm01.R", 2, 1),
        ("left arm forward", "lowerarm01.L", 1, -1),
        ("right elbow", "wrist.R", 1, -1),
        ("left leg forward", "foot.L", 1, -1),
        ("right leg aside", "foot.R", 0, -1),
        ("right knee", "foot.R", 1, 1),
        ("trunk forward", "head", 1, -1),
    ):
        turned = posed.turned(np.zeros((len(model.J), 3)), {turn: 0.5})
        x = model.joint_transforms(model.J, turned, np.zeros(3))[1]
        k = model.joint(joint)
        assert sign * (x - rest)[k, axis] > 0.03, turn
    with pytest.raises(UserError, match="'tail': there are left arm up"):
        posed.vertices(1, {"tail": 1.0})
    assert PosedAvatar(avatar_folder).clip.frames == (0, 1, 2)
