"""Smoothing block by block: no seam, the same bits whoever does it, and no word across a gap."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.bending_tube import VERTICES, posed, smoother
from toile.config import changed, preset
from toile.io.files import load_record, save_record, write_text
from toile.io.status import Status
from toile.pipeline.blocks import FrameFolders
from toile.pipeline.identity import Identities
from toile.pipeline.smoothing import load_layers, smooth
from toile.pipeline.threads import one_blas_thread
from toile.pipeline.workers import Workers
from toile.scene import HIDDEN, INTERPOLATED, OBSERVED
from toile.stages.motion import Smoother, Strengths, strength_of

FRAMES = tuple(range(30, 80))


@dataclass(frozen=True)
class Prepared:
    smoother: Smoother
    config: object
    folder: Path
    identities: Identities = Identities(Path("/nowhere"), {"motion": "these settings"})
    fps: float = 30.0

    @property
    def capture(self):
        return SimpleNamespace(scene=SimpleNamespace(fps=self.fps))

    @property
    def templates(self):
        return self.smoother.templates


def prepare(root, holdout=(), fps=30.0, progress=None):
    return Prepared(smoother(), changed(preset("standard"), {"holdout": holdout}), root, fps=fps)


def made(frames=FRAMES, seed=0):
    """{frame: its layers}: a swinging tube, each frame with errors of its own, a strip of vertices hidden for a while."""
    rng, t = np.random.default_rng(seed), np.array(frames)
    noise = 0.003 * rng.standard_normal((2, len(t), VERTICES, 3))
    confidence = np.full((len(t), VERTICES), OBSERVED)
    confidence[(t > 44) & (t < 56), :12] = HIDDEN
    return dict(zip(frames, posed(smoother(), 0.5 * np.sin(0.2 * t), *noise, confidence)))


def scanned_at(scans):
    """The same, but the frames of these numbers alone have scans."""
    layers, other = made(), made(seed=1)
    for number in set(layers) - set(scans):
        tracked, dressed = other[number]
        guessed = np.full_like(tracked.confidence, INTERPOLATED)
        sleeve = replace(dressed["sleeve"], confidence=np.zeros_like(guessed))
        layers[number] = replace(tracked, confidence=guessed), {"sleeve": sleeve}
    return layers


def folders(root):
    status = Status(root / "status.jsonl")
    return FrameFolders(root / "frames", status, "frame"), FrameFolders(root / "smoothed", status, "motion")


def load(raw, prepared, number):
    return load_layers(raw.folder(number), prepared.templates)


def run(root, layers, workers=1, holdout=(), fps=30.0):
    """The sleeve and the tube by frame, smoothed."""
    raw, smoothed = folders(root)
    for number, (tracked, dressed) in layers.items():
        save_record(raw.folder(number) / "track.npz", tracked)
        save_record(raw.folder(number) / "dress.sleeve.npz", dressed["sleeve"])
        write_text(raw.folder(number) / "whole", "")
    with one_blas_thread(), Workers(workers, prepare, root, holdout, fps) as pool:
        smooth(partial(load, raw), list(layers), smoothed, pool.prepared(), pool)
    return {n: loaded(root, n) for n in layers}


def loaded(root, number):
    tracked, dressed = load_layers(folders(root)[1].folder(number), smoother().templates)
    return np.concatenate([dressed["sleeve"].vertices, tracked.vertices, tracked.rotations])


def second(x):
    return np.linalg.norm(x[2:] - 2 * x[1:-1] + x[:-2], axis=2).mean(1)


def test_a_block_s_border_shows_no_seam(tmp_path):
    layers = made()
    found = np.stack(list(run(tmp_path, layers).values()))
    bends = second(found)
    borders = [50 - FRAMES[0] - 2, 50 - FRAMES[0] - 1]
    assert bends[borders].max() < 1.5 * np.median(bends)
    prepared = prepare(tmp_path)
    frames = list(layers.values())
    once = prepared.smoother.smooth(frames, strength_of(prepared.smoother.gather(frames), 10, 10))
    at_once = np.stack([np.concatenate([d["sleeve"].vertices, t.vertices, t.rotations]) for t, d in once])
    assert np.abs(found - at_once).max() < 0.1 * bends.mean()  # and blocks differ little from no blocks


@pytest.mark.parametrize("scans", [range(30, 80, 6), (40, 67), (31, 74)])
def test_a_block_s_border_shows_no_seam_where_only_some_frames_have_scans(tmp_path, scans):
    """Scans as near as the margin and farther: what a frame without takes from them is the same for every block."""
    layers = scanned_at(scans)
    found = np.stack(list(run(tmp_path, layers).values()))
    prepared, frames = prepare(tmp_path), list(layers.values())
    once = prepared.smoother.smooth(frames, load_record(tmp_path / "strengths.npz", Strengths))
    at_once = np.stack([np.concatenate([d["sleeve"].vertices, t.vertices, t.rotations]) for t, d in once])
    raw = np.stack([np.concatenate([d["sleeve"].vertices, t.vertices, t.rotations]) for t, d in frames])
    assert np.abs(found - at_once).max() < 1e-4 < 0.1 * np.abs(raw - at_once).max()


@pytest.mark.parametrize("workers", [1, 2])
def test_the_same_bits_with_workers_and_after_a_stop(tmp_path, workers):
    layers = made()
    once = run(tmp_path / "once", layers)
    raw, smoothed = folders(tmp_path / "again")
    run(tmp_path / "again", layers)
    for number in (47, 50, 51, 79):  # as if a kill had come before them
        (smoothed.folder(number) / "whole").unlink()
        (smoothed.folder(number) / "track.npz").unlink()
    again = run(tmp_path / "again", layers, workers)
    assert all(np.array_equal(once[n], again[n]) for n in layers)


@pytest.mark.parametrize("step, fps", [(3, 30.0), (1, 5.0)])
def test_frames_apart_are_left_as_they_are(tmp_path, step, fps):
    """By their numbers, or in time."""
    layers = {n: x for n, x in made().items() if n % step == 0}
    found = run(tmp_path, layers, fps=fps)
    for number, (tracked, dressed) in layers.items():
        kept = np.concatenate([dressed["sleeve"].vertices, tracked.vertices, tracked.rotations])
        assert np.array_equal(found[number], kept)


def test_frames_too_far_apart_to_be_smoothed_take_their_surfaces_from_scans_none_the_less(tmp_path):
    layers = scanned_at(range(30, 80, 3))
    found = run(tmp_path, layers, fps=10.0)
    plain = lambda number: np.concatenate([layers[number][1]["sleeve"].vertices, layers[number][0].vertices])
    kept = {n: np.allclose(found[n][: 2 * VERTICES], plain(n), atol=1e-9) for n in layers}
    assert all(kept[n] == (n % 3 == 0) for n in layers)
    for number, (tracked, _) in layers.items():  # poses stay as they are
        assert np.array_equal(found[number][2 * VERTICES :], tracked.rotations)


def test_a_gap_of_any_length_parts_the_frames(tmp_path):
    """What lies beyond a frame that failed changes nothing but the strengths, which all frames tell."""
    layers = {n: x for n, x in made().items() if n not in (56, 62, 63)}
    once = run(tmp_path / "once", layers)
    other = {n: made(seed=1)[n] if n > 63 else x for n, x in layers.items()}
    (tmp_path / "again").mkdir()
    strengths = "strengths.npz"
    (tmp_path / "again" / strengths).write_bytes((tmp_path / "once" / strengths).read_bytes())
    again = run(tmp_path / "again", other)
    assert all(np.array_equal(once[n], again[n]) == (n < 62) for n in layers)


def test_frames_held_out_change_no_bit_of_the_others(tmp_path):
    layers, other = made(), made(seed=1)
    spoiled = {n: other[n] if 46 <= n <= 58 else x for n, x in layers.items()}
    once = run(tmp_path / "once", layers, holdout=(46, 58))
    again = run(tmp_path / "again", spoiled, holdout=(46, 58))
    assert all(np.array_equal(once[n], again[n]) == (not 46 <= n <= 58) for n in layers)
    strengths = [(tmp_path / name / "strengths.npz").read_bytes() for name in ("once", "again")]
    assert strengths[0] == strengths[1] and not np.array_equal(once[52], layers[52][0])


def test_each_frame_tells_how_far_it_was_moved_and_how_long_that_took(tmp_path):
    layers = made()
    run(tmp_path, layers)
    tracked, dressed = load_layers(folders(tmp_path)[1].folder(50), smoother().templates)
    for before, after in ((layers[50][0], tracked), (layers[50][1]["sleeve"], dressed["sleeve"])):
        moved = 1e3 * np.linalg.norm(after.vertices - before.vertices, axis=1).mean()
        assert after.diagnostics["smoothed_mm"] == pytest.approx(moved) and 0.5 < moved < 10
    lines = [line for line in Status(tmp_path / "status.jsonl").lines() if line["stage"] == "motion"]
    assert sorted(line["frame"] for line in lines) == list(FRAMES)
