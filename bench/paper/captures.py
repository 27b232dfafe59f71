"""The captures of a study that names none: the studio makes them, as many at once as there are workers, beside the study's work."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

from toile.kernels import threads

from .made import finished_well, once, started, studio_options

SUBJECTS = ("loose", "fitted", "logo")
FIRST_SEED = 9911  # of the first subject; the others follow. Nothing was ever chosen on these


class Captures:
    """OUT/captures/SUBJECT of every subject, begun on entering where it is absent; `options` {name: value} of StudioOptions. What is
    being made when the study ends by an error is stopped: the studio goes on with it the next time. OUT/captures/SUBJECT.json says
    how long each took."""

    def __init__(self, out, options, workers, say):
        self.place, self.options, self.say = out / "captures", options, say
        self.pool, self.each = ThreadPoolExecutor(workers), max(threads() // workers, 1)
        self.running, self.stopped, self.begun = [], threading.Event(), {}

    @property
    def folders(self):
        return tuple(self.place / subject for subject in SUBJECTS)

    def __enter__(self):
        for folder in self.folders:
            self.begun[folder] = self.pool.submit(self._made, folder)
        return self

    def __exit__(self, kind, *_):
        if kind is not None:
            self.pool.shutdown(wait=False, cancel_futures=True)
            self.stopped.set()
            for studio in tuple(self.running):
                studio.terminate()
        self.pool.shutdown()

    def ready(self, folder):
        """Waits until the capture is there; raises what went wrong with it."""
        self.begun[folder].result()

    def _made(self, folder):
        subject = folder.name
        asked = self.options | {"subject": subject, "seed": FIRST_SEED + SUBJECTS.index(subject)}

        def make():
            if not folder.exists():
                self._by_studio(folder, asked)
            return {"capture": str(folder)}

        once(folder.with_suffix(".json"), make, self.say)
        there = studio_options(folder) or {}  # also of one that an earlier study made
        other = {name: there.get(name) for name, value in asked.items() if there.get(name) != value}
        if other:
            raise SystemExit(f"{folder}: it was made with {other}, this study asks for {asked}: give it another folder")

    def _by_studio(self, folder, asked):
        words = [word for name, value in asked.items() for word in ("--set", f"{name}={value}")]
        studio = started("studio", folder, "--workers", 1, "--quiet", *words, threads=self.each)
        self.running.append(studio)
        if self.stopped.is_set():
            studio.terminate()
        finished_well(studio)
