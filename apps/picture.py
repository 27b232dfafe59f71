"""The pictures of the README from a run of the demo: captured, tracked surface, inner body, both layers; and the avatar on
a frame that it was not trained on, as a camera saw it and from places where no camera stands."""

from pathlib import Path

import numpy as np
from PIL import Image

from toile.io.capture import open_capture
from toile.io.run import open_run
from toile.measure.rendering import BODY, CLOTH, render

ROOT = Path(__file__).parents[1]
SIZE = (480, 360)


def main():
    run = open_run(ROOT / "demo" / "run")
    capture = open_capture(ROOT / "data_samples" / "tshirt-talk")
    images = capture.frame(0).images
    facing = max(images, key=lambda name: -capture.cameras[name].centre[1])  # the person faces -y
    first, shirt = run.ok[0], run.garments["tshirt"]
    track, body = ((surface.at(first), surface.faces, BODY) for surface in (run.track, run.inner))
    shirt = shirt.at(first), shirt.faces, CLOTH[0]
    tiles = [np.asarray(Image.fromarray(images[facing]).resize((SIZE[0], SIZE[0])))[:, 60:420]]
    for parts in ([track], [body], [body, shirt]):
        tiles.append(render(parts, 0, size=SIZE))
    Image.fromarray(np.concatenate(tiles, axis=1)).save(ROOT / "docs" / "pictures" / "layers.jpg", quality=85)
    avatar().save(ROOT / "docs" / "pictures" / "avatar.jpg", quality=85)


def avatar():
    """The whole window of the demo's sheet, and below it the unseen views."""
    sheets = sorted((ROOT / "demo" / "avatar" / "sheets").glob("*.png"))
    sheet, unseen = (np.asarray(Image.open(path)) for path in sheets)  # FRAME_CAMERA before FRAME_unseen
    picture = np.full((len(unseen) * 2, unseen.shape[1], 3), unseen[-1, -1], np.uint8)
    picture[: len(unseen), : sheet.shape[1]] = sheet[: len(unseen)]
    picture[len(unseen) :] = unseen
    return Image.fromarray(picture)


if __name__ == "__main__":
    main()
