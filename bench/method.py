"""What is measured: a method solves the problems of one kernel, after a preparation that its later frames share."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec


@dataclass(frozen=True)
class Method:
    """`prepare(problem)` -> `solve(frame)` -> result. A problem maps names to arrays; `frame` is the same, or in a
    sequence the frame's arrays with `start`, the result of the frame before. `prepare` does the template's part.

    Results: vertices (n,3) of register, sequence and untangle, displacements (n,3) of biharmonic, labels (n,) of mrf.
    """

    name: str
    kernel: str  # register, sequence, biharmonic, mrf or untangle
    module: str  # that must be importable
    prepare: Callable
    slow: bool = False  # minutes a problem: few problems are given
    levels: tuple[int, ...] = (1, 2, 3, 4, 5)  # of a registration problem
    oracle: bool = False  # knows the truth: a floor, no competitor

    @property
    def ours(self):
        return self.module == "toile"

    def installed(self):
        return find_spec(self.module) is not None


def once(solve):
    """A `prepare` for methods that share nothing between frames."""
    return lambda problem: solve
