"""Hostile inputs: each is refused in one line that names it, exit code 1, and nothing is left behind. No traceback, no hang."""

import json
import shutil
import signal
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.faults.hostile import CASES, FRAME, SAMPLE
from toile import cli

SECONDS = 300  # within which every input must be answered, by a busy machine too


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """One frame of the bundled capture with a template of few triangles and a body model of its own, which are read fast."""
    folder = tmp_path_factory.mktemp("hostile") / "capture"
    skipped = shutil.ignore_patterns("truth", "templates", "00000[1-5]", "cam0[3-7].*")
    shutil.copytree(SAMPLE, folder, ignore=skipped)
    text = (SAMPLE / "scene.toml").read_text()
    text = text.replace("templates/tshirt.obj", "templates/tube.obj").replace('"anny"', '"body.npz"')
    (folder / "scene.toml").write_text(text)
    cameras = json.loads((folder / "cameras.json").read_text())["cameras"][:3]
    (folder / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    keypoints = json.loads((folder / FRAME / "keypoints.json").read_text())
    keypoints["points"] = {camera["name"]: keypoints["points"][camera["name"]] for camera in cameras}
    (folder / FRAME / "keypoints.json").write_text(json.dumps(keypoints))
    (folder / "templates").mkdir()
    (folder / "templates" / "tube.obj").write_text(tube(0.2, 0.5, 12))
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    arrays = dict(
        v_template=corners, f=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]), parents=np.array([-1, 0])
    )
    np.savez(folder / "body.npz", **arrays, J=np.zeros((2, 3)), weights=np.full((4, 2), 0.5))
    return folder


def tube(radius, height, around):
    """An open cylinder as OBJ."""
    a = np.arange(around) / around * 2 * np.pi
    ring = np.stack([radius * np.cos(a), radius * np.sin(a)], 1)
    lines = [f"v {x:.6f} {y:.6f} {z}" for z in (0, height) for x, y in ring]
    for i in range(1, around + 1):
        j = i % around + 1
        lines += [f"f {i} {j} {around + j}", f"f {i} {around + j} {around + i}"]
    return "\n".join(lines) + "\n"


BVH = """HIERARCHY
ROOT Hips
{
OFFSET 0 0 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
End Site
{
OFFSET 0 10 0
}
}
MOTION
Frames: 2
Frame Time: 0.033
0.0 0.0 90.0 0.0 0.0 0.0
0.0 0.0 90.0 0.0 0.0 0.0
"""


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile") / "motion"
    folder.mkdir()
    np.savez(folder / "motion.npz", rotations=np.zeros((3, 104, 3)), translation=np.zeros((3, 3)), fps=30.0)
    (folder / "motion.bvh").write_text(BVH)
    return folder


@pytest.fixture
def kinds(request, capture, motion):
    """The folder of each kind; runs and avatars are made when first asked for."""

    def find(kind):
        if kind in ("capture", "motion"):
            return {"capture": capture, "motion": motion}[kind]
        if kind == "run":
            return request.getfixturevalue("sample_run")
        avatar = request.getfixturevalue("sample_avatar")
        return avatar if kind == "layered" else avatar / "baseline"

    return find


@contextmanager
def answered_in_time():
    """A wait without end becomes an error of its own."""

    def late(*_):
        raise TimeoutError(f"not answered within {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def arguments(case, kinds, spoilt, out):
    """The command line of a case; folders that it does not spoil are the whole ones."""
    known = {"IN": lambda: spoilt, "OUT": lambda: out, "AVATAR": lambda: kinds("avatar")}
    known["MOTION"] = lambda: kinds("motion") / "motion.npz"
    for word in map(str, case.command):
        first, mark, rest = (word[:3], ".", word[4:]) if word.startswith("OUT.") else word.partition("/")
        yield f"{known[first]()}{mark}{rest}" if first in known else word


def large(folder, names):
    """What no case gets as far as to read: caches, checkpoints, and chunks of a store's large arrays."""
    chunks = ["c"] if Path(folder).name in ("vertices", "skin", "rotations", "labels") else []
    return {"cache", "checkpoints", "prepared", "evaluation", *chunks} & set(names)


def files(folder):
    return {p.relative_to(folder): p.lstat().st_mtime_ns for p in folder.rglob("*") if not p.name.startswith(".lock")}


marked = [
    pytest.param(case, id=name, marks=[pytest.mark.slow(seconds=4)] if case.slow else [])
    for name, case in CASES.items()
]


@pytest.mark.parametrize("case", marked)
def test_hostile_input_is_refused_in_one_line(kinds, tmp_path, monkeypatch, capsys, case):
    spoilt, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(kinds(case.kind), spoilt, symlinks=True, ignore=large)
    case.spoil(spoilt)
    before = files(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["toile", *arguments(case, kinds, spoilt, out)])
    with pytest.raises(SystemExit) as stop, answered_in_time():
        cli.main()
    said = capsys.readouterr().err
    lines = [line for line in said.splitlines() if line.strip() and "\u2501" not in line]
    assert stop.value.code == 1, said[-2000:]
    assert len(lines) == 1 and lines[0].startswith("toile: ") and len(lines[0]) < 1100, said[-2000:]
    for part in case.said:
        assert part in lines[0]
    assert files(tmp_path) == before, "something was left behind"


def test_there_are_two_hundred_of_them():
    assert len(CASES) >= 200 and len({(c.kind, FRAME) for c in CASES.values()}) >= 5


def test_what_the_cases_spoil_is_accepted_whole(capture, monkeypatch, capsys):
    from toile.io.capture import check_capture, open_capture

    opened = open_capture(capture)
    check_capture(opened, opened.frames)
    monkeypatch.setattr("sys.argv", ["toile", "plan", str(capture)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 0 and capsys.readouterr().err.startswith("next: toile register ")
