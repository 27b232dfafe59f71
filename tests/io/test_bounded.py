"""What a file claims of itself is checked before it is believed."""

import io
import os
import zipfile

import numpy as np
import pytest
from PIL import Image

from toile.errors import UserError
from toile.io.bounded import read_json, read_npz, read_text, read_toml
from toile.io.image import read_image, read_rgba


def npy(header, data=b""):
    """The bytes of an array with a header of one's own."""
    text = repr(header).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


def archive(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(f"{name}.npy", data)
    return path


@pytest.mark.parametrize(("read", "text"), [(read_json, "[" * 100_000), (read_toml, "a = " + "[" * 100_000)])
def test_deep_nesting_is_refused(tmp_path, read, text):
    (tmp_path / "deep").write_text(text)
    with pytest.raises(UserError, match="deep: not (JSON|TOML): nested too deeply"):
        read(tmp_path / "deep")


def test_npz_comes_back_to_the_bit_and_only_what_is_asked(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array("text"), "c": np.zeros((0, 3), np.int32)}
    np.savez_compressed(tmp_path / "x.npz", **arrays)
    found = read_npz(tmp_path / "x.npz")
    assert found.keys() == arrays.keys() and all(np.array_equal(found[n], v) for n, v in arrays.items())
    assert list(read_npz(tmp_path / "x.npz", names=("a",))) == ["a"]


def test_every_kind_of_plain_array_comes_back_as_numpy_reads_it(tmp_path):
    by_columns = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    given = {"columns": by_columns, "one": np.array(3.5), "text": np.array("a b"), "none": np.zeros((0, 3), np.int32)}
    np.savez(tmp_path / "a.npz", **given)
    found, plain = read_npz(tmp_path / "a.npz"), np.load(tmp_path / "a.npz")
    for name, array in found.items():
        np.testing.assert_array_equal(array, plain[name], strict=True)
        assert array.flags.writeable and array.flags.f_contiguous == plain[name].flags.f_contiguous


def test_an_archive_that_would_inflate_beyond_the_bound_is_not_inflated(tmp_path):
    path = archive(tmp_path / "bomb.npz", a=b"\0" * 10_000_000)
    assert path.stat().st_size < 20_000
    with pytest.raises(UserError, match="bomb.npz: its arrays have 10000000 bytes, at most 1000000"):
        read_npz(path, most=1_000_000)


def test_a_shape_that_the_member_does_not_hold_allocates_nothing(tmp_path):
    header = {"descr": "<f8", "fortran_order": False, "shape": (1 << 40, 3)}
    with pytest.raises(UserError, match="big.npz: a: float64"):
        read_npz(archive(tmp_path / "big.npz", a=npy(header)))


def test_pickles_and_nonsense_are_refused(tmp_path):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.array([{}], object))
    with pytest.raises(UserError, match="x.npz: a: holds pickled objects"):
        read_npz(archive(tmp_path / "x.npz", a=stream.getvalue()))
    for data in (b"", b"\x93NUMPY", b"\x93NUMPY\x09\x00xx", npy("nonsense")):
        with pytest.raises(UserError, match="x.npz: "):
            read_npz(archive(tmp_path / "x.npz", a=data))


@pytest.mark.parametrize("read", [read_text, read_npz, lambda path: read_image(path, (4, 4), "RGB")])
def test_a_pipe_is_refused_unopened(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UserError, match="pipe: not an ordinary file"):
        read(tmp_path / "pipe")


@pytest.mark.parametrize("kind", ["BMP", "TIFF", "GIF", "PPM"])
def test_images_are_png_or_jpeg_whatever_their_name(tmp_path, kind):
    Image.new("RGB", (4, 4)).save(tmp_path / "x.png", kind)
    with pytest.raises(UserError, match="x.png: cannot be read as a PNG or JPEG"):
        read_rgba(tmp_path / "x.png")


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path):
    for name, text, read in (("a.json", '{"a": 1}', read_json), ("a.toml", "a = 1\r\n", read_toml)):
        (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + text.encode())
        assert read(tmp_path / name) == {"a": 1}
