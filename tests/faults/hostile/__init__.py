"""The table of hostile inputs: a name -> what is spoilt, the command that meets it, and what its message must name."""

from tests.faults.hostile import avatars, captures, runs
from tests.faults.hostile.cases import CASES, FRAME, SAMPLE

__all__ = ["CASES", "FRAME", "SAMPLE", "avatars", "captures", "runs"]
