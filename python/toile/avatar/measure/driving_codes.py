"""What drives the single-layer baseline, whose code says of its clothes what the pose does not: every way that could be
strongest, so that none is chosen for it.

temporal model   the model that drives the layers' garments, taught in the same way on the baseline's own codes
mean code        of the frames that it was trained on
code zero        the mean of the Gaussian that its codes are drawn to
unit Gaussian    a code drawn from that Gaussian, one a sequence, as Bagautdinov et al. (2021) animate theirs
own Gaussian     a code drawn from the mean and the covariance of its own codes
"""

from __future__ import annotations

import torch

from ..drive.driver import FILE, load_driver, reader_of, run_track
from ..drive.teaching import codes_of, data_of
from ..model.checkpoint import read_facts

TEMPORAL, MEAN, ZERO = "temporal model", "mean code", "code zero"
UNIT, OWN = "unit Gaussian", "own Gaussian"
# as programs read them
RIVALS = {"draw": UNIT, "mean_code": MEAN, "zero": ZERO, "own_gaussian": OWN, "driven": TEMPORAL}
DRAWS = 16  # codes of each Gaussian


def driving_codes(folder, avatar, run, span):
    """{row: {frame: code (1,Z)}} of the frames of `span`; of a Gaussian a row a draw, "unit Gaussian 3". Without a
    temporal model there is no such row."""
    rows, surface = {}, avatar.layers[0].name
    facts = read_facts(folder)
    codes = codes_of(avatar, data_of(run, folder, facts, "cache", facts["frames"]))[0]
    if (folder / FILE).exists():
        driver, stride, _ = load_driver(folder)
        track = run_track(reader_of(folder, avatar), run, stride)
        with torch.no_grad():
            found = driver.latents(track)[surface]
        at = {n: i for i, n in enumerate(track.frames.tolist())}
        rows[TEMPORAL] = {n: found[at[n]][None] for n in span}
    fixed = {MEAN: codes.mean(0), ZERO: torch.zeros_like(codes[0])}
    fixed |= {f"{UNIT} {k}": drawn(len(codes[0]), k) for k in range(DRAWS)}
    fixed |= {f"{OWN} {k}": like(codes, k) for k in range(DRAWS)}
    return rows | {name: dict.fromkeys(span, z[None]) for name, z in fixed.items()}


def drawn(size, seed):
    """A sample (size,) of the unit Gaussian."""
    return torch.randn(size, generator=torch.Generator().manual_seed(seed))


def like(codes, seed):
    """A sample (Z,) of the Gaussian with the mean and the covariance of codes (F,Z)."""
    mean = codes.mean(0)
    return mean + drawn(len(codes), seed) @ (codes - mean) / max(len(codes) - 1, 1) ** 0.5


def rivals(rows):
    """{rival: {"mse", "band_mse", "ssim"}} of the rows that are there."""
    return {
        name: {measure: rows[row][measure] for measure in ("mse", "band_mse", "ssim")}
        for name, row in RIVALS.items()
        if row in rows
    }


def kind_of(row):
    """The row without the number of its draw."""
    return next((kind for kind in (UNIT, OWN) if row.startswith(kind)), row)
