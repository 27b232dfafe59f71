"""Images, masks and label maps: PNG or JPEG, checked against their camera before they are decoded."""

from __future__ import annotations

from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything
from .bounded import check_file, reason_of
from .files import replace_file

MAX_PIXELS = 100_000_000
MAX_BYTES = 1 << 30
FORMATS = ("PNG", "JPEG")


def read_rgba(path: Path | str) -> Anything:
    """A picture of any size as (H,W,4) uint8, upright as its camera's note says; opaque where it has no alpha."""
    from PIL import ImageOps

    with _opened(path) as image:
        return np.array(ImageOps.exif_transpose(image).convert("RGBA"))


def image_header(path: Path | str) -> tuple[tuple[int, int], str]:
    """(height, width) and pillow's mode of a picture, of which only the header is read."""
    with _opened(path) as image:
        width, height = image.size
        return (height, width), image.mode


def turned(path: Path | str) -> bool:
    """Whether a picture's header (EXIF) asks viewers to turn or mirror it, as cameras held upright do; `read_image` does not."""
    from PIL import ExifTags

    with _opened(path) as image:
        return image.getexif().get(ExifTags.Base.Orientation, 1) != 1


def colour_profile(path: Path | str) -> str:
    """The name of the colour space (ICC) that a picture says it is in; "" for none and for sRGB, by which pictures are read."""
    from PIL import ImageCms

    with _opened(path) as image:
        profile = image.info.get("icc_profile")
        name = ImageCms.getProfileDescription(ImageCms.getOpenProfile(BytesIO(profile))).strip() if profile else ""
    return "" if "srgb" in name.lower() else name


def one_channel(path: Path) -> Anything:
    """(H,W) uint8 of a mask that was saved in colour, by a palette or as transparency: its alpha where that is not opaque
    throughout, else the brightest channel of each pixel's colour; `_full` of a PNG."""
    with _opened(path) as image:
        return _full(_brightest(image), image)


def _full(mask: Anything, image: Any) -> Anything:
    """A mask (H,W) uint8; of a PNG of 0 and 1 alone, as booleans are saved, that of 0 and 255. A JPEG's 1 is noise."""
    return 255 * mask if image.format == "PNG" and mask.max() == 1 else mask


def _brightest(image: Any) -> Anything:
    pixels = np.array(image.convert("RGBA"))
    alpha = pixels[..., 3]
    return alpha if alpha.min() < 255 else pixels[..., :3].max(2)


def read_image(path: Path, size: tuple[int, int], mode: str) -> Anything:
    """(H,W,3) uint8 for mode "RGB", (H,W) uint8 for "L", a mask, of a palette by its colours and of 0 and 1 as of 0 and 255, and for
    "P", label ids, by its indices. UserError for another size than (height, width)."""
    with _opened(path) as image:
        _check_size(path, image, size)
        if mode == "P":
            _check_labels(path, image)
            return np.array(image.convert("L") if image.mode == "1" else image)
        if mode == "L":
            _check_channel(path, image)
            return _full(_brightest(image) if image.mode == "P" else np.array(image.convert("L")), image)
        return np.array(image if image.mode == mode else image.convert(mode))


def check_labels(path: Path | str) -> None:
    """UserError unless a file's header says that it is a label image: of one channel, and not of a kind that changes ids."""
    with _opened(path) as image:
        _check_labels(path, image)


def check_image(path: Path, size: tuple[int, int]) -> None:
    """UserError unless a file's header says that it is a picture of that (height, width); its pixels are not read."""
    with _opened(path) as image:
        _check_size(path, image, size)


def _check_size(path: Path, image: Any, size: tuple[int, int]) -> None:
    width, height = image.size
    if (height, width) != tuple(size):
        raise UserError(f"{path}: {width} x {height} pixels, cameras.json says {size[1]} x {size[0]}")


def _check_labels(path: Path | str, image: Any) -> None:
    if image.format == "JPEG":
        raise UserError(f"{path}: a JPEG, which changes label ids at their borders: expected a PNG")
    _check_channel(path, image)


def _check_channel(path: Path | str, image: Any) -> None:
    if image.mode not in ("L", "P", "1"):
        raise UserError(f"{path}: mode {image.mode}, expected one channel of 8 bits")


def _bits(path: Path | str) -> int:
    """Bits a channel of a PNG, as the 25th byte says."""
    with open(path, "rb") as file:
        return file.read(25)[24]


def write_image(path: Path, pixels: Anything) -> None:
    """(H,W,3) or (H,W) uint8 as a whole file: JPEG for the suffix .jpg, else PNG."""
    from PIL import Image

    options = {"format": "JPEG", "quality": 95} if path.suffix == ".jpg" else {"format": "PNG"}
    replace_file(path, lambda part: Image.fromarray(pixels).save(part, **options))


@contextmanager
def _opened(path: Path | str) -> Any:
    """The image, of which only the header has been read; whatever is wrong with it becomes a UserError."""
    from PIL import Image

    check_file(path, MAX_BYTES)
    try:
        with Image.open(path, formats=FORMATS) as image:
            width, height = image.size
            if width * height > MAX_PIXELS:
                raise UserError(f"{path}: {width} x {height} pixels, at most {MAX_PIXELS} are read")
            if (
                image.format == "PNG" and _bits(path) > 8
            ):  # converted, it would be cut off at 255 or lose its lower half
                raise UserError(f"{path}: {_bits(path)} bits a channel, expected 8")
            yield image
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{path}: cannot be read as a PNG or JPEG image: {reason_of(error)}") from None
