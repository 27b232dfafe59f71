"""Which problems a run of the trade-off holds, where their files are, and which methods meet which."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from . import clothing, kernel_problems, problems, sequences
from .person import SyntheticPerson

CAPTURE = Path(__file__).parents[1] / "data_samples" / "tshirt-talk"
HELD_OUT = (101, 102, 103)
HARMONIC = {"3k": 3_000, "12k": 12_000, "50k": 50_000, "198k": 198_000}
REFERENCE_BELOW = 60_000  # vertices of a biharmonic problem that get a reference solution
SLOW = ("L1_noise1", "L2_noise1", "L3_noise1", "L4_noise1", "shirt_000", "untangle_5k", "seq_L1", "seq_L3")
# a peer fails on level 5, with 9 GB; and takes minutes at 53k
NO_PEER = ("L5_clean", "L5_noise3", "L2_clean_src53k", "L4_clean_src53k", "L3_noise1_src53k")


@dataclass(frozen=True)
class Problem:
    kernel: str
    name: str
    seed: int  # 0: none
    path: Path
    panel: str  # what it is averaged with
    level: int = 0

    def given_to(self, method, first_seed):
        if method.kernel != self.kernel or (self.level and self.level not in method.levels):
            return False
        if method.oracle:
            return self.panel in ("L1", "L2", "L3", "L4") and self.seed == first_seed
        if method.slow:
            return self.name in SLOW and self.seed in (0, first_seed)
        if method.ours:
            return True
        return self.name not in NO_PEER and self.seed in (0, first_seed)


@dataclass
class Plan:
    """Problems of a run, written under `folder` where they are missing."""

    folder: Path
    quick: bool
    seeds: tuple[int, ...]
    capture: Path = CAPTURE
    problems: list[Problem] = field(default_factory=list)

    @cached_property
    def person(self):
        return SyntheticPerson()

    def write(self, say):
        self._kernels(say)
        self._shirts()
        for seed in self.seeds:
            self._pairs(seed, say)
            self._sequences(seed, say)
        return self.problems

    def _pairs(self, seed, say):
        for name, level, corruption, size, vertices in problems.family():
            plain = name == f"L{level}_{corruption}"
            if self.quick and (corruption != "noise1" or not plain):
                continue
            if seed != self.seeds[0] and not plain and not name.startswith("L2_noise1"):
                continue
            path = self.folder / str(seed) / f"{name}.npz"
            if not path.exists():
                say(f"problem {seed}/{name}")
                save(path, problems.make(self.person, self.person.template(size), level, corruption, vertices, seed))
            panel = f"L{level}" if plain else f"{size} template, {vertices // 1000}k target"
            self.problems.append(Problem("register", name, seed, path, panel, level))

    def _sequences(self, seed, say):
        if seed != self.seeds[0] and self.quick:
            return
        folder, frames = self.folder / str(seed), 12 if self.quick else sequences.FRAMES
        if not (folder / "seq_L3" / f"{frames - 1:03d}.npz").exists():
            say(f"problem {seed}/sequences")
            sequences.write(folder, self.person, seed, frames)
        self.problems += [Problem("sequence", n, seed, folder / n, n) for n in ("seq_L1", "seq_L3")]

    def _shirts(self):
        from toile.io.capture import open_capture

        for number in (0, 3)[: 1 if self.quick else 2]:
            path = self.folder / "shirts" / f"shirt_{number:03d}.npz"
            if not path.exists():
                clothing.write(path.parent, open_capture(self.capture), [number])
            self.problems.append(Problem("register", path.stem, 0, path, "shirt", level=2))

    def _kernels(self, say):
        for name, make in self._small_problems():
            path = self.folder / "kernels" / f"{name}.npz"
            if not path.exists():
                say(f"problem {name}")
                save(path, make())
            kernel = name.split("_")[0]
            self.problems.append(Problem(kernel, name, 0, path, name.replace("_", " ")))

    def _small_problems(self):
        sizes = list(HARMONIC)[: 2 if self.quick else 4]
        for size in sizes:
            yield f"biharmonic_{size}", lambda n=HARMONIC[size]: harmonic(n)
        for size, points in {"13k": None, "99k": 100_000}.items():
            if points is None or not self.quick:
                yield f"mrf_{size}", lambda points=points: self._labelling(points)
        for size, n in {"5k": 5_700, "12k": 13_700}.items():
            if size == "5k" or not self.quick:
                yield f"untangle_{size}", lambda n=n: kernel_problems.shirt_through_body(self.person, n)
        for depth in (1, 3):
            yield f"untangle_push{depth}cm", lambda depth=depth: clothing.pushed(self.capture, 0.01 * depth)

    def _labelling(self, points):
        if points is None:
            template = self.person.template("14k")
            return kernel_problems.labelling(template.points @ self.person.rest, template.faces)
        rng = np.random.default_rng(0)
        return kernel_problems.labelling(*problems.target_surface(self.person, self.person.rest, points, rng))


def harmonic(vertices):
    problem = kernel_problems.patch(vertices)
    return problem | (dict(D=kernel_problems.harmonic_reference(problem)) if vertices < REFERENCE_BELOW else {})


def save(path, arrays):
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part.npz")
    np.savez_compressed(partial, **arrays)
    partial.rename(path)
