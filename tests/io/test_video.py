"""Films hold the pictures that were put in."""

import numpy as np
import pytest

from tests.support.small_disk import largest_file
from toile.errors import first_line
from toile.io.video import VideoWriter

av = pytest.importorskip("av")


def pictures(n=5, size=(48, 64)):
    y, x = np.mgrid[: size[0], : size[1]]
    return [
        np.stack([(4 * x + 10 * k) % 256, (3 * y) % 200 + 20, 0 * x + 30 * k], -1).astype(np.uint8) // 2 + 40
        for k in range(n)
    ]


def write(path, frames, fps=30):
    with VideoWriter(path, fps) as film:
        for frame in frames:
            film.add(frame)
    return path


def test_a_film_gives_its_pictures_back(tmp_path):
    put = pictures()
    with av.open(str(write(tmp_path / "a.mp4", put))) as film:
        stream = film.streams.video[0]
        assert stream.codec_context.name == "h264" and stream.average_rate == 30
        got = [f.to_ndarray(format="rgb24") for f in film.decode(stream)]
    assert len(got) == len(put)
    assert max(np.abs(g.astype(int) - p).mean() for g, p in zip(got, put)) < 6  # chroma at half the resolution


@pytest.mark.parametrize("fps", [30, 29.97 / 5, 0.3, 1e-5])
def test_a_film_lasts_as_long_as_its_rate_says_down_to_a_picture_in_1001_seconds(tmp_path, fps):
    with av.open(str(write(tmp_path / "a.mp4", pictures(), fps))) as film:
        lasts = film.duration / av.time_base
    assert lasts == pytest.approx(5 / max(fps, 1 / 1001), rel=1e-3)


def test_the_same_pictures_give_the_same_bits(tmp_path):
    once = write(tmp_path / "a.mp4", pictures()).read_bytes()
    assert all(write(tmp_path / "b.mp4", pictures()).read_bytes() == once for _ in range(40))


def test_odd_sides_lose_one_row_or_column(tmp_path):
    with av.open(str(write(tmp_path / "a.mp4", pictures(2, (47, 63))))) as film:
        assert (film.streams.video[0].height, film.streams.video[0].width) == (46, 62)


def test_a_broken_film_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError):
        with VideoWriter(tmp_path / "a.mp4", 30) as film:
            film.add(pictures(1)[0])
            raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with VideoWriter(tmp_path / "b.mp4", 30):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_film_that_a_disk_does_not_take_is_called_by_its_name(tmp_path):
    with largest_file(100), pytest.raises(OSError) as raised, VideoWriter(tmp_path / "a.mp4", 30) as film:
        for picture in pictures():
            film.add(picture)
    assert first_line(raised.value) == f"{tmp_path}/a.mp4: File too large" and list(tmp_path.iterdir()) == []
