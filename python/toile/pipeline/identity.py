"""What each result of a run depends on. An identity is a digest of a stage's settings, of what it reads of the capture, and
of the identities of the stages before it; every result carries its own. A result whose identity is the one that is asked for
is kept, any other is made again: so a changed setting, file or frame redoes what depends on it and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ..config import Config
from ..io.bounded import read_json
from ..io.capture import Capture
from ..io.inputs import digest
from ..io.run_folder import note_of
from ..scene import Vote


@dataclass(frozen=True)
class Stage:
    """`settings`: fields of Config; `facts`: tables of io/facts.py; `after`: stages. `clothed`: it runs where the scene names
    a garment, `printed`: where one has prints."""

    settings: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    clothed: bool = False
    printed: bool = False


STAGES = {  # the first four are made once a run, the others of every frame
    "scan": Stage(("make_scans", "least_depth", "stereo", "reconstruct"), ("scene", "cameras")),
    "person": Stage(("preparation_frames", "reconstruct", "track"), ("scene", "body", "cameras")),
    "colours": Stage(("scan_spacing", "picture_side", "segment"), ("labels", "segmenter"), ("person",), clothed=True),
    "template": Stage(("dress", "template_from_scan"), ("garments",), ("colours",), clothed=True),
    "track": Stage(("holdout",), after=("person",)),
    "segment": Stage(after=("track", "colours"), clothed=True),
    "dress": Stage(after=("segment", "template"), clothed=True),
    "prints": Stage(("prints",), ("prints", "time"), ("dress",), printed=True),
    "motion": Stage(("motion",), ("time",), ("track", "dress", "prints")),
    "inner": Stage(("inner",), (), ("motion",), clothed=True),
    "verdict": Stage(("verdict",), (), ("inner", "motion")),
}
LAST = "verdict"


def stages_of(capture: Capture, config: Config, facts: dict[str, Any], sampled: dict[int, str]) -> dict[str, str]:
    """The identity of every stage, by this version of toile. `sampled`: what was read of the frames that the preparation is made of, by number."""
    from .. import __version__

    settings, garments, found = config.model_dump(mode="json"), capture.scene.garments, {}
    for name, stage in STAGES.items():
        if (stage.clothed and not garments) or (stage.printed and not any(g.prints for g in garments)):
            found[name] = digest(name, [found[before] for before in stage.after[:1]])
            continue
        values = {key: settings[key] for key in stage.settings}
        values |= {} if stage.after else {"toile": __version__}  # another version makes other results of the same
        read: Any = {table: facts[table] for table in stage.facts}
        if name == "person":
            read["sampled"] = sampled
        if name == "template":
            read["votes"] = [votes_on(capture.votes, number) for number in sampled]
        found[name] = digest(name, values, read, [found[before] for before in stage.after])
    return found


def votes_on(votes: tuple[Vote, ...], number: int) -> list[Any]:
    """A person's word on a frame."""
    found = [vote for vote in votes if vote.frames is None or number in vote.frames]
    return [[int(v.label), v.prefer, [int(i) for i in v.vertices]] for v in found]


@dataclass(frozen=True)
class Identities:
    """The identities that a request asks for: of the stages of its run, and of every frame's results."""

    run: Path
    stages: dict[str, str]
    sampled: tuple[int, ...] = ()  # the frames that the preparation is made of
    votes: tuple[Vote, ...] = ()

    def of(self, stage: str, frame: int) -> str:
        """What a stage makes of a frame."""
        voted = [] if stage == "track" else votes_on(self.votes, frame)
        return digest(self.stages[stage], self.inputs(frame), voted)

    def step(self, stage: str, frame: int, previous: int | None) -> str:
        """The same, from the temporal state of the frame `previous`."""
        return digest(self.of(stage, frame), previous)

    def inputs(self, frame: int) -> str:
        """What was read of a frame."""
        path = note_of(self.run, frame)
        if not path.exists():
            return ""
        files, lacks_scan, tries = _noted(str(path), path.stat().st_mtime_ns)
        return digest(files, self.stages["scan"] if lacks_scan else "", tries)


@lru_cache(maxsize=4096)
def _noted(path: str, _changed: int) -> tuple[str, bool, int]:
    note = read_json(path, dict)
    files = {name: stamp[-1] for name, stamp in note.get("files", {}).items()}
    return digest(files), bool(note.get("lacks_scan")), int(note.get("tries", 0))
