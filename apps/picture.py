"""The picture of the README from a run of the demo: captured, tracked surface, inner body, both layers."""

from pathlib import Path

import numpy as np
import zarr
from PIL import Image

from toile.capture import open_capture
from toile.report import BODY, CLOTH, render

ROOT = Path(__file__).parents[1]
SIZE = (480, 360)


def main():
    group = zarr.open_group(str(ROOT / "demo" / "run" / "registered.zarr"), mode="r")
    capture = open_capture(ROOT / "data_samples" / "tshirt-talk")
    images = capture.frame(0).images
    facing = max(images, key=lambda name: -capture.cameras[name].centre[1])  # the person faces -y
    track = (group["track/vertices"][0], group["track/faces"][:], BODY)
    body = (group["inner/vertices"][0], group["inner/faces"][:], BODY)
    shirt = (group["garment/tshirt/vertices"][0], group["garment/tshirt/faces"][:], CLOTH[0])
    tiles = [np.asarray(Image.fromarray(images[facing]).resize((SIZE[0], SIZE[0])))[:, 60:420]]
    for parts in ([track], [body], [body, shirt]):
        tiles.append(render(parts, 0, size=SIZE))
    Image.fromarray(np.concatenate(tiles, axis=1)).save(ROOT / "docs" / "layers.jpg", quality=85)


if __name__ == "__main__":
    main()
