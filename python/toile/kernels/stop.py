"""Why a kernel ended."""

from enum import StrEnum


class Stop(StrEnum):
    """`result.stop` of every iterative kernel is one of these, as a string: `result.stop == "converged"` holds as
    `result.stop == Stop.converged` does. Not to converge is a result, not an error.
    """

    converged = "converged"  # steps below the tolerance, or no move that lowers the energy: nricp, skeleton, inner, mrf
    clear = "clear"  # nothing left inside, intersecting, or nearer than its margin: untangle
    max_iterations = "max_iterations"  # the most iterations (mrf: sweeps) that the options allow were made: all
    stalled = "stalled"  # further steps left no less to do: untangle
    unmatched = "unmatched"  # no part of the scan within reach; keypoints and priors alone gave the answer: skeleton
    no_overlap = "no_overlap"  # no part of the scan near the template, V is NaN: nricp
