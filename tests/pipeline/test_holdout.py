"""Frames held out of a registration: whatever they show, nothing that an avatar is trained on changes by a bit."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import zarr
from PIL import Image

from toile.align.run import align
from toile.align.settings import AlignSettings
from toile.avatar.settings import DataSettings
from toile.avatar.train.data import AvatarData
from toile.config import changed, preset
from toile.errors import UserError
from toile.io.run import open_run
from toile.pipeline.run import register

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
HELD = (2, 3)
TRAINED = [0, 1, 4, 5]
CONFIG = changed(preset("draft"), {"holdout": HELD, "preparation_frames": 3, "prints.anchor_frames": 2})
QUICK = AlignSettings(
    lattice_spacing=0.012, blurs=(0.024, 0.012), blur_steps=(2, 1), length_steps=2, anchor_frames=2, sample_frames=2, mean_rounds=1,
)  # fmt: skip
SEEN = DataSettings(geometry_size=32, texture_size=64, modes=2, image=(64, 64), pixel_scale=4.0, window=2)


def printed(root):
    """The bundled capture with a shirt that has prints."""
    shutil.copytree(SAMPLE, root)
    scene = root / "scene.toml"
    scene.write_text(scene.read_text().replace('label = "tshirt"', 'label = "tshirt"\nprints = true'))
    return root


def spoil(capture):
    """Noise in the place of what the frames held out show: pictures, scans, keypoints."""
    rng = np.random.default_rng(0)
    for number in range(HELD[0], HELD[1] + 1):
        frame = capture / "frames" / f"{number:06d}"
        for path in sorted((frame / "images").iterdir()):
            size = Image.open(path).size
            Image.fromarray(rng.integers(0, 256, (*size[::-1], 3), dtype=np.uint8)).save(path)
        other = SAMPLE / "frames" / "000000"
        shutil.copyfile(other / "scan.ply", frame / "scan.ply")
        shutil.copyfile(other / "keypoints.json", frame / "keypoints.json")


def registered(root):
    """{array: what training reads of it} of a run and of the one aligned from it, and what avatars read of the latter."""
    assert not register(root / "capture", root / "run", CONFIG).failed
    assert not align(root / "run", root / "aligned", QUICK).failed
    run = open_run(root / "aligned")
    assert run.holdout == HELD
    data = AvatarData(run, SEEN, root / "cache", TRAINED)
    found = {f"layer {x.name} {k}": v for x in data.layers for k, v in vars(x).items() if isinstance(v, np.ndarray)}
    found |= {f"mean texture {name}": values for name, values in data.mean_texture.items()}
    for i in range(len(data)):
        found |= {f"sample {i} {name}": value.numpy() for name, value in data[i].items()}
    for place in ("run", "aligned"):
        found |= {f"{place} {name}": values for name, values in stored(root / place).items()}
    return found


def stored(run):
    """The arrays of a run's store, of the frames that an avatar is trained on."""
    group = zarr.open_group(str(run / "registered.zarr"), mode="r")
    rows = [row for row, number in enumerate(group["frames"][:].tolist()) if number in TRAINED]
    arrays = {name: item for name, item in group.members(max_depth=None) if isinstance(item, zarr.Array)}
    framed = {name: item.shape[0] == len(group["frames"][:]) and name != "frames" for name, item in arrays.items()}
    return {
        name: item[:][rows] if framed[name] else item[:]
        for name, item in arrays.items()
        if not name.startswith("diagnostics/seconds/")
    }


@pytest.mark.slow(seconds=120)
def test_noise_in_the_frames_held_out_changes_no_bit_of_what_training_reads(tmp_path):
    for name in ("clean", "spoiled"):
        printed(tmp_path / name / "capture")
    spoil(tmp_path / "spoiled" / "capture")
    clean, spoiled = (registered(tmp_path / name) for name in ("clean", "spoiled"))
    assert clean.keys() == spoiled.keys() and any(name.startswith("run confidence/") for name in clean)
    differ = [
        name
        for name in clean
        if not np.array_equal(clean[name], spoiled[name], equal_nan=clean[name].dtype.kind == "f")
    ]
    assert not differ
    shown = [open_run(tmp_path / name / "run").track.at(HELD[0]) for name in ("clean", "spoiled")]
    assert not np.array_equal(*shown)  # the noise was read where it may be


@pytest.mark.parametrize(
    "holdout, reason", [((0, 5), "no frame is left to make the person of"), ((400, 459), "no frame lies there")]
)
def test_a_hold_out_of_all_frames_or_of_none_is_refused(tmp_path, holdout, reason):
    with pytest.raises(UserError, match=f"--holdout {holdout[0]}-{holdout[1]}: {reason}"):
        register(SAMPLE, tmp_path / "run", CONFIG, holdout=holdout)
    assert not (tmp_path / "run").exists()
