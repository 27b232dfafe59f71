"""The captures of a study that names none: the studio makes them, as many at once as there are workers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from toile.kernels import threads

from .study import once, toile

SUBJECTS = ("loose", "fitted", "logo")
FIRST_SEED = 9911  # of the first subject; the others follow. Nothing was ever chosen on these


def made_captures(out, options, workers, say):
    """OUT/captures/SUBJECT of every subject, made where it is absent; `options` [str] of `toile studio`. Their folders, in order.
    OUT/captures/SUBJECT.json says how long each took."""
    each = max(threads() // workers, 1)
    place = out / "captures"

    def make(subject):
        words = ("--subject", subject, "--seed", FIRST_SEED + SUBJECTS.index(subject), "--workers", 1, "--quiet")
        if not (place / subject).exists():
            toile("studio", place / subject, *words, *options, threads=each)
        return {"capture": str(place / subject)}

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda subject: once(place / f"{subject}.json", lambda: make(subject), say), SUBJECTS))
    return tuple(place / subject for subject in SUBJECTS)
