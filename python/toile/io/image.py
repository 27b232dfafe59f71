"""Images, masks and label maps, checked against their camera."""

import numpy as np

from ..errors import UserError

MAX_PIXELS = 100_000_000


def read_rgba(path):
    """A picture of any size as (H,W,4) uint8, upright as its camera's note says; opaque where it has no alpha."""
    from PIL import Image, ImageOps

    try:
        with Image.open(path) as image:
            width, height = image.size
            if width * height > MAX_PIXELS:
                raise UserError(f"{path}: {width} x {height} pixels, at most {MAX_PIXELS} are read")
            return np.array(ImageOps.exif_transpose(image).convert("RGBA"))
    except UserError:
        raise
    except FileNotFoundError:
        raise UserError(f"{path}: the file is missing") from None
    except Exception as error:
        raise UserError(f"{path}: cannot be read as an image: {error}") from None


def read_image(path, size, mode):
    """(H,W,3) uint8 for mode "RGB", (H,W) uint8 for "L". UserError for another size than (height, width)."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            width, height = image.size
            if width * height > MAX_PIXELS:
                raise UserError(f"{path}: {width} x {height} pixels, at most {MAX_PIXELS} are read")
            if (height, width) != tuple(size):
                raise UserError(f"{path}: {width} x {height} pixels, cameras.json says {size[1]} x {size[0]}")
            if mode == "L" and image.mode not in ("L", "P", "1"):
                raise UserError(f"{path}: mode {image.mode}, expected one channel of 8 bits")
            return np.array(image if mode == "L" and image.mode == "P" else image.convert(mode))
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{path}: cannot be read as an image: {error}") from None
