"""Layered avatars against the single layer: registers captures, trains both per seed, evaluates, adds the results up.

Everything lies in one folder, and what lies there is not made again: a study that was stopped goes on.
    OUT/CAPTURE/run   OUT/CAPTURE/seed0/{avatar, baseline/, evaluation.json}   OUT/study.json   OUT/study.md
"""

from __future__ import annotations

import json
import platform
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

BAND_GAIN = 0.20  # the layered avatar's squared error near the garment's border is lower by this share at least
PARITY = 0.05  # on the body alone both avatars' errors lie this near to each other, or the baseline is a straw man


@dataclass(frozen=True)
class Study:
    """What is measured."""

    out: Path
    captures: tuple[Path, ...]
    seeds: tuple[int, ...]
    settings: object  # AvatarSettings, whose seed is replaced
    registration: str = "standard"
    frames: str | None = None  # of each capture, as in `toile register --frames`
    holdout: str | None = None  # "A-B"
    minutes: float | None = None  # of each layered training; the baseline takes as many steps

    def run(self, say, progress):
        """All captures and seeds; the table is written anew after each. Returns the summary."""
        for capture in self.captures:
            run = self._register(capture, say, progress)
            for seed in self.seeds:
                self._measure(run, self.out / capture.name / f"seed{seed}", seed, say, progress)
                write(self.out, self.describe())
        return summary(self.out)

    def describe(self):
        import torch

        return {
            "settings": self.settings.model_dump(mode="json"), "registration": self.registration, "frames": self.frames,
            "holdout": self.holdout, "minutes": self.minutes, "torch": torch.__version__, "machine": platform.machine(),
            "device": torch.cuda.get_device_name() if torch.cuda.is_available() else f"CPU, {torch.get_num_threads()} threads",
        }  # fmt: skip

    def _register(self, capture, say, progress):
        from toile.capture import open_capture
        from toile.cli import frame_numbers
        from toile.config import preset
        from toile.pipeline import register

        run = self.out / capture.name / "run"
        numbers = frame_numbers(self.frames, open_capture(capture).frames)
        outcome = register(capture, run, preset(self.registration), numbers, progress)
        say(f"{capture.name}: {len(outcome.ok)} frames registered, {len(outcome.failed)} failed")
        return run

    def _measure(self, run, folder, seed, say, progress):
        from toile.avatar.evaluation import evaluate_avatar
        from toile.avatar.make import Request, make_avatar

        if (folder / "evaluation.json").exists():
            return
        begun = time.time()
        settings = self.settings.model_copy(update={"seed": seed})
        stages = lambda stage, done, total, note="": progress(stage, done, total)  # noqa: E731
        make_avatar(Request(run, settings, self.minutes, self.holdout, stages, say), folder, baseline=True)
        result = evaluate_avatar(folder, progress=progress)
        result["seconds"] = time.time() - begun
        save(folder / "evaluation.json", result)
        say(f"{folder}: {line(result['all'])}")


def save(path, values):
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(values, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    partial.rename(path)


def line(found):
    """An evaluation in words."""
    layered, baseline = found["layered"], found["baseline"]
    words = [f"{m} {layered[m]:.1f} against {baseline[m]:.1f}" for m in ("mse", "band_mse", "body_mse") if baseline[m]]
    return ", ".join(words)


def evaluations(out):
    """{(capture, seed): evaluation} of what a study's folder holds."""
    found = {}
    for path in sorted(Path(out).glob("*/seed*/evaluation.json")):
        found[path.parts[-3], int(path.parts[-2].removeprefix("seed"))] = json.loads(path.read_text(encoding="utf-8"))
    return found


def summary(out):
    """{capture: measures over its seeds}: means, the least and largest relative change, and whether the goals are met."""
    by_capture = {}
    for (capture, seed), result in evaluations(out).items():
        by_capture.setdefault(capture, {})[seed] = result["all"]
    return {capture: _over_seeds(seeds) for capture, seeds in by_capture.items()}


def _over_seeds(seeds):
    row = {"seeds": sorted(seeds)}
    for measure in ("mse", "band_mse", "body_mse", "garment_mse", "ssim", "band_ssim", "psnr"):
        values = {name: [s[name][measure] for s in seeds.values()] for name in ("layered", "baseline")}
        if None in values["layered"] + values["baseline"]:
            continue
        row[measure] = {name: float(np.mean(v)) for name, v in values.items()}
        if measure.endswith("mse"):
            change = np.array(values["layered"]) / np.array(values["baseline"]) - 1
            row[measure] |= {"change": float(change.mean()), "best": float(change.min()), "worst": float(change.max())}
    row["goals"] = goals(row)
    return row


def goals(row):
    """Each with whether every seed meets it: "How good" asks for it on each subject over three seeds."""
    found = {"foreground no worse": "mse" in row and row["mse"]["worst"] <= 0}
    if "band_mse" in row:
        found["band 20 % lower"] = row["band_mse"]["worst"] <= -BAND_GAIN
    if "body_mse" in row:
        # the baseline is no straw man: at most 5 % worse than the layered avatar where both show the bare body
        found["body within 5 %"] = 1 / (1 + row["body_mse"]["best"]) - 1 <= PARITY
    return found


def write(out, described):
    """OUT/study.json and OUT/study.md of what is there."""
    save(Path(out) / "study.json", {"study": described, "captures": summary(out)})
    (Path(out) / "study.md").write_text(table(out), encoding="utf-8")


def table(out):
    """The evaluations as Markdown, a row a capture and seed, then what the goals say."""
    head = "| capture | seed | MSE layered | single | change | band layered | single | change | body change | SSIM layered | single |"
    lines = [head, "|---" * 11 + "|"]
    for (capture, seed), result in evaluations(out).items():
        layered, baseline = result["all"]["layered"], result["all"]["baseline"]
        cells = [capture, str(seed)]
        for measure in ("mse", "band_mse"):
            cells += [_number(layered[measure]), _number(baseline[measure]), _change(measure, layered, baseline)]
        cells += [_change("body_mse", layered, baseline), _number(layered["ssim"], 4), _number(baseline["ssim"], 4)]
        lines.append(f"| {' | '.join(cells)} |")
    for capture, row in summary(out).items():
        met = ", ".join(f"{goal}: {'yes' if ok else 'no'}" for goal, ok in row["goals"].items())
        lines.append(f"\n{capture}, {len(row['seeds'])} seed{'s' * (len(row['seeds']) != 1)}: {met}")
    return "\n".join(lines) + "\n"


def _number(value, digits=1):
    return "-" if value is None else f"{value:.{digits}f}"


def _change(measure, layered, baseline):
    if not layered[measure] or not baseline[measure]:
        return "-"
    return f"{100 * (layered[measure] / baseline[measure] - 1):+.1f} %"
