"""What a run was asked for, in RUN/config.toml, and what it has read, in RUN/inputs. The capture may be moved, mended or
grow, and settings may change: what depends on it is made again, see `identity`."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..config import Config
from ..config.settings import listed
from ..errors import UserError
from ..io.bounded import read_json
from ..io.capture import Capture
from ..io.facts import changed_facts, facts_of
from ..io.files import write_text
from ..io.holdout import apart, words_of
from ..io.inputs import contents, stamps
from ..io.layout import STORE
from ..io.locks import locked
from ..io.run import is_run, open_run
from ..io.run_folder import capture_folder, config_file, note_of, read_config, scene_note_of
from ..scene import Vote
from .identity import STAGES, Identities, stages_of
from .scanning import lacks_scan

OWN = (".lock", ".busy", ".config.toml", "inputs")  # what a run that was killed at once may have left
MADE = ("status.jsonl", "work", "prepared", "diagnostics", "scans", STORE)  # by a run, once it has its config.toml
PLACE = "capture", "capture_from_here"  # what `place_of` says


@dataclass(frozen=True)
class Asked:
    """What a run is asked for: its frames, the identities of its results, what it was asked for before and is no longer in
    words, and whether that makes another process's work useless."""

    frames: tuple[int, ...]
    identities: Identities
    notes: tuple[str, ...] = ()
    other: bool = False


def check_folder(run: Path) -> None:
    """UserError: the folder holds something else than a run of `toile register`, or one that cannot be gone on with."""
    path = config_file(run)
    check_own(run)
    if path.exists() and "align" in read_config(run):
        raise UserError(f"{run}: an aligned run: register into another folder")
    if is_run(run) and path.exists() and not open_run(run).resumable:
        raise UserError(f"{run}: registered by an older version, which did not say what it made of what: register anew")


def check_own(run: Path) -> None:
    """UserError: there is something that is no run."""
    if run.exists() and not run.is_dir():
        raise UserError(f"{run}: is no folder")
    if run.exists() and not config_file(run).exists():
        there = sorted(p.name for p in run.iterdir() if not p.name.startswith(OWN))
        if there and set(there) <= set(MADE):
            raise UserError(
                f"{run}: holds no run, but what one left that was removed while it was worked at: remove {', '.join(there)} there"
            )
        if there:
            raise UserError(f"{run}: the folder is not empty and holds no run")


def config_of(run: Path) -> Config | None:
    """The settings that a run was asked for; None where there is none yet, or none that is understood."""
    settings = read_config(run).get("settings") if config_file(run).exists() else None
    try:
        return Config.model_validate_json(json.dumps(settings), strict=True) if isinstance(settings, dict) else None
    except ValueError:
        return None


def request_of(
    run: Path,
    capture: Capture,
    config: Config,
    frames: Sequence[int],
    own: Iterable[int],
    sample: Any,
    verify: bool = False,
) -> Asked:
    """What is asked for now, beside what was: notes of the frames `own` that were read before are brought up to date, by the
    files' names, sizes and times, with `verify` by all their contents. `sample(frames)`: the frames that the preparation
    is made of. Nothing else is written. UserError names the field by which another capture is told from one that was moved."""
    before = read_config(run) if config_file(run).exists() else {}
    known = tuple(int(number) for number in before.get("frames", ()))
    wanted = known if set(frames) <= set(known) else tuple(sorted({*known, *frames})) if known else tuple(frames)
    facts, old = facts_of(capture), read_json(scene_note_of(run), dict) if scene_note_of(run).exists() else {}
    if before and not _same_place(run, capture.root):
        _check_moved(run, capture, facts, old, own)
    changed = [n for n in own if note_of(run, n).exists() and note_frame(run, capture, n, verify)]
    sampled = _sampled(run, config, wanted, sample)
    for number in sampled:
        if number not in own or not note_of(run, number).exists():
            note_frame(run, capture, number, verify)
    read = Identities(run, {"scan": stages_of(capture, config, facts, {})["scan"]})
    stages = stages_of(capture, config, facts, {number: read.inputs(number) for number in sampled})
    redone = [name for name in STAGES if stages[name] != old.get("stages", stages).get(name)]
    notes = _words(config, before, facts, old, redone, changed, len(wanted) - len(known) if known else 0)
    other = bool(before) and (bool(redone) or wanted != known)
    return Asked(wanted, Identities(run, stages, tuple(sampled), capture.votes), notes, other)


def write_request(run: Path, capture: Capture, config: Config, request: Asked) -> None:
    """Keeps it in RUN/config.toml."""
    from .. import __version__

    asked = place_of(run, capture.root) | {
        "frames": list(request.frames),
        "versions": {"toile": __version__, "numpy": np.__version__},
        "settings": config.model_dump(mode="json"),
    }
    votes = [[int(v.label), v.vertices.tolist(), v.prefer, v.frames and list(v.frames)] for v in capture.votes]
    note = {"facts": facts_of(capture), "stages": request.identities.stages, "votes": votes}
    if not scene_note_of(run).exists() or read_json(scene_note_of(run), dict) != note:
        write_text(scene_note_of(run), json.dumps(note, indent=1))
    _write_config(run, asked)


def asked_last(run: Path) -> tuple[Identities, str] | None:
    """The identities that a run was asked for last, and the stage that ends its first pass; None where an older version kept less.
    UserError: the file was changed."""
    note = read_json(scene_note_of(run), dict) if scene_note_of(run).exists() else {}
    if "votes" not in note:
        return None
    try:
        votes = [
            Vote(label, np.array(V), prefer, frames and tuple(frames)) for label, V, prefer, frames in note["votes"]
        ]
        stages = {name: str(note["stages"][name]) for name in STAGES}
        return Identities(run, stages, votes=tuple(votes)), "dress" if note["facts"]["garments"] else "track"
    except (KeyError, TypeError, ValueError):
        raise UserError(
            f"{scene_note_of(run)}: stages, facts, votes: not as they were written; toile register writes them anew"
        ) from None


def place_of(run: Path, capture: Path) -> dict[str, str]:
    """What a run's config.toml says of where its capture lies."""
    there = capture.resolve()
    return {"capture": str(there), "capture_from_here": os.path.relpath(there, run.resolve())}


def note_moved(run: Path, capture: Capture) -> None:
    """Keeps where the capture of a run, or of an aligned one, lies now; makes nothing else. UserError names the field by which
    another capture is told."""
    config = read_config(run)
    made = Path(config["align"]["run"]) if "align" in config else run  # that which read the capture
    old = read_json(scene_note_of(made), dict) if scene_note_of(made).exists() else {}
    with locked(run):
        _check_moved(made, capture, facts_of(capture), old, config.get("frames", ()))
        _write_config(run, config | place_of(run, capture.root))


def claim(run, asked, refusal):
    """Makes the folder `run` with a config.toml that holds the table `asked`, or checks that its own is the same wherever the
    capture lies; else UserError: `refusal`."""
    path, place = config_file(run), {name: asked[name] for name in PLACE if name in asked}
    check_own(Path(run))
    with locked(run):
        if path.exists() and read_config(run) | place != _toml(asked):
            raise UserError(f"{path}: {refusal}")
        _write_config(run, asked)


def _write_config(run, asked):
    import tomli_w

    if not config_file(run).exists() or read_config(run) != _toml(asked):
        write_text(config_file(run), tomli_w.dumps(asked))


def _toml(asked):
    import tomli_w

    return tomllib.loads(tomli_w.dumps(asked))


# What was read -------------------------------------------------------------------------------------------------------


def note_frame(run: Path, capture: Capture, number: int, verify: bool = False) -> bool:
    """Keeps in RUN/inputs what a frame's files are: {file: [bytes, time [ns], sha256]}. Has one changed since? Of a frame that
    is gone what is known stays."""
    path = note_of(run, number)
    note = read_json(path, dict) if path.exists() else {}
    then = note.get("files", {})
    if then and not capture.has(number):
        return False
    files: dict[str, Any] = {}
    for name, stamp in stamps(capture.root, capture.inputs(number)).items():
        kept = not verify and then.get(name, [])[:2] == list(stamp)
        files[name] = then[name] if kept else [*stamp, contents(capture.root / name)]
    found = {"lacks_scan": lacks_scan(capture, number), "tries": note.get("tries", 0), "files": files}
    if found != note:
        write_text(path, json.dumps(found, indent=1))
    sums = {name: stamp[-1] for name, stamp in files.items()}
    return bool(then) and sums != {name: stamp[-1] for name, stamp in then.items()}


def try_again(run: Path, frames: Iterable[int]) -> None:
    """All results of these frames are asked for anew."""
    for number in frames:
        path = note_of(run, number)
        note = read_json(path, dict) if path.exists() else {}
        write_text(path, json.dumps(note | {"tries": note.get("tries", 0) + 1}, indent=1))


def _sampled(run, config, frames, sample):
    """The frames that the preparation is made of; once chosen they stay, also where the run is extended."""
    path, asked = run / "inputs" / "sampled.json", config.preparation_frames
    kept, seen = read_json(path, dict) if path.exists() else {}, apart(frames, config.holdout)
    if config.holdout and len(seen) in (0, len(frames)):
        which = "no frame lies there" if seen else "no frame is left to make the person of"
        raise UserError(f"--holdout {words_of(config.holdout)}: {which}")
    if kept.get("asked") != asked or len(apart(kept["frames"], config.holdout)) < len(kept["frames"]):
        kept = {"asked": asked, "frames": [int(number) for number in sample(seen)]}
        write_text(path, json.dumps(kept))
    return kept["frames"]


def _same_place(run, root):
    try:
        return os.path.samefile(capture_folder(run), root)
    except (OSError, UserError):
        return False


def _check_moved(run, capture, facts, old, own):
    for table, values in old.get("facts", {}).items():
        now = facts.get(table, {})
        for name in sorted(values.keys() | now.keys()):
            if values.get(name) != now.get(name):
                raise _another(run, capture, f"{table}.{name} differs")
    for number in own:
        then = read_json(note_of(run, number), dict).get("files", {}) if note_of(run, number).exists() else {}
        for name in then if capture.has(number) else ():
            if not (capture.root / name).is_file() or (capture.root / name).stat().st_size != then[name][0]:
                raise _another(run, capture, f"{name} differs")


def _another(run, capture, why):
    return UserError(
        f"{capture.root}: {why} from what {run} read of {capture_folder(run, check=False)}: is it another capture? "
        "Register it into another folder"
    )


def _words(config, before, facts, old, redone, changed, more):
    """What differs from what was asked before, a line each."""
    found, named = [], [*_changed_settings(config, before), *changed_facts(facts, old.get("facts", facts))]
    if redone and before:
        what = f"changed: {', '.join(named[:4])}{f' and {len(named) - 4} more' if len(named) > 4 else ''}"
        what = what if named else "files of the frames that the preparation is made of have changed"
        found.append(f"{what}; made again: {', '.join(name for name in redone if name != 'scan') or 'scans'}")
    if changed:
        found.append(f"files have changed of {'frame' if len(changed) == 1 else 'frames'} {_some(changed)}: made again")
    if more > 0:
        found.append(f"{more} frames more; the person, the templates and the fused body stay")
    return tuple(found)


def _changed_settings(config, before):
    """In words, the settings and the version that are others than in the config.toml `before`."""
    from .. import __version__

    then = _flat(before.get("settings", {}))
    now = {one.name: _plain(one.default) for one in listed(config) if one.name != "quality"}
    for name, value in now.items():
        if name in then and then[name] != value:
            yield f"{name} {then[name]} -> {value}"
    by = before.get("versions", {}).get("toile", __version__)
    if by != __version__:
        yield f"toile {by} -> {__version__}"


def _some(numbers):
    return ", ".join(map(str, numbers[:10])) + (f" and {len(numbers) - 10} more" if len(numbers) > 10 else "")


def _flat(table, prefix=""):
    found = {}
    for name, value in table.items():
        found |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return found


def _plain(value):
    return [_plain(item) for item in value] if isinstance(value, tuple) else value
