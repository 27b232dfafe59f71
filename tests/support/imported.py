"""A folder of somebody's pictures beside a calibration in JSON, and the capture that is made of it."""

from PIL import Image

from tests.support.calibrations import write_json
from tests.support.cube import views
from toile.io.importing import write_capture
from toile.io.rig import Options, read_rig


def save(path, size, value=90, mode="RGB"):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new(mode, size, (value, 0, 0) if mode == "RGB" else value).save(path)


def rig(folder, layout="images/{camera}/{number:06d}.jpg", numbers=(0, 2, 10)):
    made = views()
    folder.mkdir(exist_ok=True)
    write_json(folder, made)
    for v in made:
        for number in numbers:
            save(folder / layout.format(camera=v.name, number=number), (v.width, v.height), 10 + number)
    return made


def imported(folder, out, **options):
    return write_capture(read_rig("lists", folder, Options(up="z", **options)), out, "test")
