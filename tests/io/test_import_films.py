"""Films beside a calibration: decoded in step, and those that lack pictures said."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.calibrations import write_json
from tests.support.cube import views
from tests.support.imported import imported, rig
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.rig import Options, read_rig


def test_pictures_of_films_are_decoded_with_their_offset(tmp_path):
    pytest.importorskip("av")
    from toile.io.video import VideoWriter

    made = views()
    (tmp_path / "their").mkdir()
    write_json(tmp_path / "their", made)
    for v in made:
        with VideoWriter(tmp_path / "their" / "videos" / f"{v.name}.mp4", 30) as film:
            for i in range(6):
                film.add(np.full((v.height, v.width, 3), 20 + 30 * i, np.uint8))
    imported(tmp_path / "their", tmp_path / "ours", offsets={"front": 2})
    capture = open_capture(tmp_path / "ours")
    assert capture.frames == (0, 1, 2, 3, 4, 5) and capture.scene.fps == 30
    images = capture.frame(1).images
    assert {name: round((int(image.mean()) - 20) / 30) for name, image in images.items()} == {
        "left": 1, "front": 3, "cam 3": 1,
    }  # fmt: skip
    assert "front" not in capture.frame(5).images


def film(path, view, times, rate=30):
    """A film of a picture at each of `times` [1/rate s]."""
    import av

    path.parent.mkdir(exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height, stream.pix_fmt = view.width, view.height, "yuv420p"
        for time in times:
            picture = av.VideoFrame.from_ndarray(np.full((view.height, view.width, 3), time, np.uint8), "rgb24")
            picture.pts = time
            container.mux(stream.encode(picture))
        container.mux(stream.encode())


def test_films_that_were_scaled_since_their_calibration_are_taken_when_said(tmp_path):
    pytest.importorskip("av")
    made = views()
    (tmp_path / "their").mkdir()
    write_json(tmp_path / "their", made)
    for v in made:
        film(
            tmp_path / "their" / "videos" / f"{v.name}.mp4",
            replace(v, width=v.width // 2, height=v.height // 2),
            range(2),
        )
    with pytest.raises(UserError, match=r"\.mp4: .* were they scaled since: --scaled"):
        imported(tmp_path / "their", tmp_path / "ours")
    imported(tmp_path / "their", tmp_path / "ours", scaled=True)
    capture = open_capture(tmp_path / "ours")
    assert {name: image.shape[:2] for name, image in capture.frame(1).images.items()} == {
        v.name: (v.height // 2, v.width // 2) for v in made
    }
    np.testing.assert_allclose(capture.cameras["left"].K[:2], made[0].K_half[:2] / 2)


def test_a_film_that_dropped_pictures_or_ends_early_says_so(tmp_path):
    pytest.importorskip("av")
    made = views()
    write_json(tmp_path, made)
    times = {"left": range(9), "front": [0, 1, 2, 5, 6, 7, 8, 10, 11], made[2].name: range(6)}
    for v in made:
        film(tmp_path / "videos" / f"{v.name}.mp4", v, times[v.name])
    notes = imported(tmp_path, tmp_path / "ours", fps=30.0).notes
    said = [note for note in notes if ".mp4" in note]
    assert said == [
        "front.mp4: lacks 3 pictures by its times: from picture 3 on it is out of step",
        f"{made[2].name}.mp4: no pictures of 3 frames: 6-8",
    ]
    assert all(f"# {line}\n" in (tmp_path / "ours" / "scene.toml").read_text() for line in said)


def test_a_film_without_a_picture_is_refused(tmp_path):
    pytest.importorskip("av")
    made = views()
    write_json(tmp_path, made)
    for v in made:
        film(tmp_path / "videos" / f"{v.name}.mkv", v, range(3))
    path = tmp_path / "videos" / "left.mkv"
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(UserError, match=r"videos/left\.mkv: no picture in it"):
        imported(tmp_path, tmp_path / "ours", fps=30.0)
    assert not (tmp_path / "ours").exists()


def test_frames_follow_as_fast_as_those_of_the_films(tmp_path):
    pytest.importorskip("av")
    from toile.io.video import VideoWriter

    made = views()
    write_json(tmp_path, made)

    def filmed(*rates):
        for v, rate in zip(made, rates):
            with VideoWriter(tmp_path / "videos" / f"{v.name}.mp4", rate) as film:
                for _ in range(6):
                    film.add(np.zeros((v.height, v.width, 3), np.uint8))

    filmed(60, 60, 60)
    found = read_rig("lists", tmp_path, Options())
    assert found.fps == 60 and "frames a second: 60" in found.notes
    filmed(60, 25)
    with pytest.raises(UserError, match=r"left.mp4 has 60 .*|.*.mp4 has 25 pictures a second, .*mp4 60: .* --fps"):
        read_rig("lists", tmp_path, Options())
    assert read_rig("lists", tmp_path, Options(fps=50.0)).fps == 50
    rig(tmp_path / "pictures")
    silent = read_rig("lists", tmp_path / "pictures", Options())
    assert silent.fps == 30 and "frames a second: 30 (assumed, give them by --fps)" in silent.notes
