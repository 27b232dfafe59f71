"""`toile align`: what a run of its own keeps, who makes it, and what it refuses."""

import json
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import zarr
from PIL import Image
from threadpoolctl import threadpool_limits

import toile.align.run
import toile.io.run
from tests.support.blas import most_blas_threads
from tests.support.stored import arrays
from toile import cli
from toile.align.report import _section, _Textures, drawn_out, torn
from toile.align.run import align
from toile.align.settings import AlignSettings
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.image import read_rgba
from toile.io.run import open_run
from toile.prints.smoothing import over_time

QUICK = AlignSettings(
    lattice_spacing=0.012,
    blurs=(0.024, 0.012),
    blur_steps=(2, 1),
    length_steps=2,
    anchor_frames=2,
    sample_frames=1,
    mean_rounds=1,
)


@pytest.fixture(scope="module")
def two_blocks(sample_run, tmp_path_factory):
    """The registered frames 0..3 renumbered 48..51, so that they lie in two blocks; frame 49 has no pictures."""
    root = tmp_path_factory.mktemp("align")
    run, capture = root / "run", root / "capture"
    shutil.copytree(sample_run, run)
    config = tomllib.loads((run / "config.toml").read_text())
    shutil.copytree(config["capture"], capture, ignore=shutil.ignore_patterns("truth", "frames"))
    for i in range(4):
        skip = shutil.ignore_patterns("images") if i == 1 else None
        shutil.copytree(f"{config['capture']}/frames/{i:06d}", capture / "frames" / f"{48 + i:06d}", ignore=skip)
        (run / "diagnostics" / f"{i:06d}.json").rename(run / "diagnostics" / f"{48 + i:06d}.json")
    zarr.open_group(str(run / "registered.zarr"), mode="r+")["frames"][:] = np.arange(48, 52)
    (run / "config.toml").write_text((run / "config.toml").read_text().replace(config["capture"], str(capture)))
    return run


@pytest.fixture(scope="module")
def undisturbed(two_blocks, tmp_path_factory):
    out = tmp_path_factory.mktemp("align") / "aligned"
    outcome = align(two_blocks, out, QUICK)
    assert outcome.whole and outcome.matched == (48, 50, 51) and outcome.between == (49,) and not outcome.failed
    return out


@pytest.fixture
def unreported(monkeypatch):
    """Pictures of the textures cost more than the alignment of three frames."""
    monkeypatch.setattr("toile.align.run.write_report", lambda *_: None)


def assert_same_bits(once, twice):
    once, twice = arrays(once), arrays(twice)
    assert once.keys() == twice.keys()
    for name in once:
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name


def test_an_aligned_run_differs_in_its_garments_alone(two_blocks, undisturbed):
    before, after = arrays(two_blocks), arrays(undisturbed)
    moved = {"garment/tshirt/vertices", "confidence/tshirt"}
    assert before.keys() == after.keys()
    for name in before.keys() - moved:
        assert np.array_equal(before[name], after[name], equal_nan=before[name].dtype.kind == "f"), name
    step = np.linalg.norm(after["garment/tshirt/vertices"] - before["garment/tshirt/vertices"], axis=2)
    assert (step.max(1) > 1e-4).all() and step.max() < 0.08
    config = tomllib.loads((undisturbed / "config.toml").read_text())
    assert (
        config["align"]["run"] == str(two_blocks.resolve())
        and config["align"]["settings"]["lattice_spacing"] == QUICK.lattice_spacing
    )
    stages = json.loads((undisturbed / "diagnostics" / "000050.json").read_text())
    assert "track" in stages and stages["align tshirt"]["misfit"] <= stages["align tshirt"]["misfit_before"]


def test_textures_before_and_after_are_reported(undisturbed):
    measures = json.loads((undisturbed / "alignment.json").read_text())["tshirt"]
    assert measures["frames"] == 3 and measures["texels"] > 10_000
    for side in ("before", "after"):
        assert 0 < measures[side]["texture_std"] < 60 and 0 < measures[side]["anchor_error"] < 60
    page = (undisturbed / "alignment.html").read_text()
    assert "error after" in page and "<script" not in page
    pictures = {path.stem: read_rgba(path) for path in (undisturbed / "alignment").glob("*.png")}
    kinds = [f"{kind}_{side}" for kind in ("mean", "deviation") for side in ("before", "after")]
    assert pictures.keys() == {f"tshirt_{kind}" for kind in (*kinds, "frames")}
    # a row a frame: its texture and its error, before and after, by every other texel
    assert pictures["tshirt_frames"].shape[:2] == (3 * 256, 4 * 256)


def test_textures_that_show_no_texel_often_enough_are_not_measured(tmp_path):
    """Each texel is seen in one frame of four, before and after."""
    colours, seen = np.full((4, 4, 3), 90, np.uint8), np.arange(16).reshape(4, 4) % 4
    textures = _Textures([(colours + 10 * k, seen == k) for k in range(4)], [True, False, False, False])
    measures = textures.measures(textures.often)
    assert measures == {"texture_std": None, "chroma_std": None, "anchor_error": None}
    whole = {"before": measures, "after": measures, "frames": 4, "texels": 0, "drawn_out": 0.0}
    assert "nan<" not in _section("tshirt", whole, {"before": textures, "after": textures}, [0, 1, 2, 3], tmp_path)


def test_cloth_that_sliding_tore_is_said(undisturbed, tmp_path):
    """One vertex in a hundred lies 30 cm from where it was: most of its edges are drawn out."""
    measures = json.loads((undisturbed / "alignment.json").read_text())
    assert 0 <= measures["tshirt"]["drawn_out"] < 1e-3 and torn(undisturbed) == ()
    run = open_run(undisturbed)
    shirt, frames = run.garments["tshirt"], run.ok[:2]
    moved = SimpleNamespace(at=lambda n: shirt.at(n) + 0.3 * (np.arange(len(shirt.at(n))) % 100 == 7)[:, None])
    assert drawn_out(shirt, shirt, frames) == 0 and 0.01 < drawn_out(shirt, moved, frames) < 0.03
    measures["tshirt"]["drawn_out"] = 0.0071
    (tmp_path / "alignment.json").write_text(json.dumps(measures))
    (words,) = torn(tmp_path)
    assert words.startswith("tshirt is torn: sliding has made 0.7 % of its edges 3 times as long")
    assert torn(tmp_path / "none") == ()


def test_shards_give_the_same_bits(two_blocks, undisturbed, tmp_path, unreported):
    second = align(two_blocks, tmp_path / "run", QUICK, shard=(2, 2))
    assert not second.whole and second.pending == (48,)
    assert align(two_blocks, tmp_path / "run", QUICK, shard=(1, 2)).whole
    assert_same_bits(undisturbed, tmp_path / "run")


def test_a_stopped_alignment_goes_on_with_the_same_bits(two_blocks, undisturbed, tmp_path, unreported):
    def stop(stage, done, total):
        if stage == "match" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        align(two_blocks, tmp_path / "run", QUICK, progress=stop)
    assert not (tmp_path / "run" / "registered.zarr").exists()
    assert align(two_blocks, tmp_path / "run", QUICK).whole
    assert_same_bits(undisturbed, tmp_path / "run")


def test_eight_blas_threads_give_the_same_bits(two_blocks, undisturbed, tmp_path, unreported):
    seen = set()
    with threadpool_limits(8, "blas"):
        align(two_blocks, tmp_path / "run", QUICK, progress=lambda *_: seen.add(most_blas_threads()))
    assert seen == {1}
    assert_same_bits(undisturbed, tmp_path / "run")


def test_other_programs_take_an_aligned_run(undisturbed):
    from toile.measure.evaluate import evaluate
    from toile.surface.layers import read_layers

    assert [layer.name for layer in read_layers(open_run(undisturbed))] == ["body", "tshirt"]
    assert evaluate(undisturbed)["all"]["frames_ok"] == 4


def test_slides_between_pictures_are_smooth_and_pass_through_what_was_measured():
    numbers, still = [0, 6, 12, 18], np.ones((5, 2))
    slides = [still * k for k in numbers]
    between = over_time(numbers, slides, range(20), 30, AlignSettings())
    assert np.abs(between[:19, 0, 0] - np.arange(19)).max() < 0.6
    assert np.allclose(over_time([3], [still], range(6), 30, AlignSettings()), 1)


def test_frames_that_no_picture_of_their_block_tells_of_are_said_to_lie_as_they_were(
    two_blocks, undisturbed, tmp_path, unreported
):
    """Frames 50 and 51, a block of their own, have lost their pictures."""
    run = shutil.copytree(two_blocks, tmp_path / "run")
    config = tomllib.loads((run / "config.toml").read_text())["capture"]
    bare = shutil.copytree(
        config, tmp_path / "capture", ignore=lambda at, _: ["images"] if at[-2:] in ("50", "51") else []
    )
    (run / "config.toml").write_text((run / "config.toml").read_text().replace(config, str(bare)))
    outcome = align(run, tmp_path / "aligned", QUICK)
    assert outcome.matched == (48,) and outcome.between == (49,)
    assert outcome.warnings[0].startswith("frames 50-51 lie as they were registered")
    step = arrays(tmp_path / "aligned")["garment/tshirt/vertices"] - arrays(run)["garment/tshirt/vertices"]
    assert np.abs(step).max((1, 2)).astype(bool).tolist() == [True, True, False, False]


def test_frames_whose_masks_are_all_empty_slide_as_those_beside_them_and_are_said(
    two_blocks, undisturbed, tmp_path, unreported
):
    run = shutil.copytree(two_blocks, tmp_path / "run")
    config = tomllib.loads((run / "config.toml").read_text())["capture"]
    blank = shutil.copytree(config, tmp_path / "capture")
    for path in (blank / "frames" / "000051" / "masks").iterdir():
        Image.fromarray(np.zeros_like(np.array(Image.open(path)))).save(path)
    (run / "config.toml").write_text((run / "config.toml").read_text().replace(config, str(blank)))
    (said,) = align(run, tmp_path / "aligned", QUICK).warnings
    assert said.startswith("frames 51: the pictures show nothing of garment tshirt, as where masks are empty")
    assert not any("show nothing" in words for words in align(two_blocks, undisturbed, QUICK).warnings)


def test_align_opens_a_run_once(two_blocks, tmp_path, monkeypatch, unreported):
    opened = []
    real = toile.io.run.open_run
    for module in (toile.io.run, toile.align.run):
        monkeypatch.setattr(module, "open_run", lambda path: (opened.append(Path(path)), real(path))[1])
    captures = []
    monkeypatch.setattr(toile.io.run, "open_capture", lambda path: (captures.append(path), open_capture(path))[1])
    align(two_blocks, tmp_path / "out", QUICK)
    assert opened == [two_blocks, tmp_path / "out"]  # the second for the report of what was made
    assert len(captures) == 1


def test_align_and_all_its_modules_import_without_torch():
    code = (
        "import sys, pkgutil, importlib; sys.modules['torch'] = None\n"
        "import toile.align, toile.prints\n"
        "rooms = (toile.align, toile.prints)\n"
        "names = [f'{r.__name__}.{m.name}' for r in rooms for m in pkgutil.iter_modules(r.__path__)]\n"
        "for name in names: importlib.import_module(name)\n"
        "print(len(names))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and int(done.stdout) > 8, done.stderr


def test_bad_input_is_refused_with_the_reason(two_blocks, undisturbed, tmp_path):
    with pytest.raises(UserError, match="folder of its own"):
        align(two_blocks, two_blocks, QUICK)
    with pytest.raises(UserError, match="other settings"):
        align(two_blocks, undisturbed, QUICK.model_copy(update={"slide_strain": 0.2}))
    with pytest.raises(UserError, match="no registered.zarr"):
        align(tmp_path, tmp_path / "out", QUICK)
    with pytest.raises(UserError, match=r"shard \(3, 2\): expected \(i, n\)"):
        align(two_blocks, tmp_path / "out", QUICK, shard=(3, 2))
    with pytest.raises(UserError, match="--holdout 48-49: .* was registered without"):
        align(two_blocks, tmp_path / "out", QUICK, holdout="48-49")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match="not empty"):
        align(two_blocks, tmp_path / "full", QUICK)
    assert not (tmp_path / "out").exists()


def test_a_run_that_was_registered_anew_is_not_taken_for_what_was_aligned(two_blocks, undisturbed, tmp_path):
    anew = shutil.copytree(two_blocks, tmp_path / "run")
    out = shutil.copytree(undisturbed, tmp_path / "aligned")
    config = (out / "config.toml").read_text()
    (out / "config.toml").write_text(config.replace(str(two_blocks.resolve()), str(anew.resolve())))
    assert align(anew, out, QUICK).whole
    shirt = next(zarr.open_group(str(anew / "registered.zarr"), mode="r+")["garment"].groups())[1]["vertices"]
    shirt[2, 7, 0] += 0.001
    with pytest.raises(UserError, match=r"config.toml: .* another registration"):
        align(anew, out, QUICK)


def test_a_run_without_garments_or_with_frames_to_come_is_refused(two_blocks, tmp_path):
    bare = shutil.copytree(two_blocks, tmp_path / "bare")
    group = zarr.open_group(str(bare / "registered.zarr"), mode="r+")
    group["done"][2] = 0
    with pytest.raises(UserError, match="pending"):
        align(bare, tmp_path / "out", QUICK)
    group.attrs["scene"] = dict(group.attrs["scene"]) | {"garments": []}
    with pytest.raises(UserError, match="no garment"):
        align(bare, tmp_path / "out", QUICK)


def test_the_command_line_reports_what_it_did(two_blocks, undisturbed, capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["toile", "align", str(two_blocks), str(two_blocks)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 1 and "folder of its own" in capsys.readouterr().err
