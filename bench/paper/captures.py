"""The captures of a study that names none: the studio makes them, as many at once as there are workers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

from toile.kernels import threads

from .made import once, toile

SUBJECTS = ("loose", "fitted", "logo")
FIRST_SEED = 9911  # of the first subject; the others follow. Nothing was ever chosen on these


def begin_captures(out, options, workers, say):
    """Begins OUT/captures/SUBJECT of every subject that is absent; `options` [str] of `toile studio`. Their folders, in order, and a
    function that waits for one of them. OUT/captures/SUBJECT.json says how long each took."""
    place, each = out / "captures", max(threads() // workers, 1)

    def make(subject):
        words = ("--subject", subject, "--seed", FIRST_SEED + SUBJECTS.index(subject), "--workers", 1, "--quiet")
        if not (place / subject).exists():
            toile("studio", place / subject, *words, *options, threads=each)
        return {"capture": str(place / subject)}

    pool = ThreadPoolExecutor(workers)
    begun = {
        place / subject: pool.submit(once, place / f"{subject}.json", partial(make, subject), say)
        for subject in SUBJECTS
    }
    pool.shutdown(wait=False)
    return tuple(begun), lambda capture: begun[capture].result()
