"""Every frame's measures: those that the run holds are read; those that have to be made are made once and kept beside it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any

from ... import __version__
from ...errors import UserError
from ...io.bounded import read_json
from ...io.files import write_text
from ...io.layout import FAILED, GOOD, OK, VERDICTS, WRONG
from ..evaluate import evaluate
from ..page import flatten
from ..truth import open_truth
from .between import Between

KEPT = "measured.json"
FAILED_STATE, PENDING_STATE = len(VERDICTS), len(VERDICTS) + 1
STATES = (*VERDICTS, "failed", "not finished")
FROM_RUN = ("evidence", "segment", "verdict")  # of `evaluate`: what is no error against a truth


@dataclass(frozen=True)
class Row:
    """One frame: its state, an index of STATES, the reasons of its verdict or failure, {STAGE:NAME: value} of its measures."""

    frame: int
    state: int
    reasons: tuple[str, ...]
    values: dict[str, float]


def measured(run, progress=None) -> tuple[list[Row], dict[str, Any]]:
    """The rows of a run, and the result of `evaluate` where its capture has a truth, of one that cannot be read "warnings" alone, else {}.
    `progress(stage, done, total)`."""
    numbers = run.frames.tolist()
    told = {number: run.diagnostics.at(number) for number in numbers}
    prints = {number: _fingerprint(stages) for number, stages in told.items()}
    kept = _read(run)
    made = _between(run, prints, kept.get("frames", {}), progress)
    truth = _truth(run, prints, kept.get("truth", {}))
    if made != kept.get("frames") or truth != kept.get("truth"):
        _keep(run, {"version": __version__, "frames": made, "truth": truth})
    result, seconds = truth.get("result", {}), _seconds(run)
    errors = {frame["frame"]: flatten(frame) for frame in result.get("per_frame", [])}
    rows = []
    for row, number in enumerate(numbers):
        values = _flat(told[number]) | seconds.get(number, {})
        values |= {f"between:{name}": value for name, value in made.get(str(number), {}).get("values", {}).items()}
        wanted = {name: value for name, value in errors.get(number, {}).items() if value is not None}
        values |= {f"truth:{name}": value for name, value in wanted.items() if not name.startswith(FROM_RUN)}
        rows.append(Row(number, *_state(run, row, told[number]), values))
    return rows, result


def _state(run, row, stages):
    """(state, reasons) of a frame."""
    done = run.done[row]
    if done == OK:
        level = GOOD if run.verdict is None else min(int(run.verdict[row]), WRONG)
        return level, tuple(str(reason) for reason in stages.get("reasons", ()))
    if done == FAILED:
        return FAILED_STATE, (str(stages.get("reason", "it failed")),)
    return PENDING_STATE, ()


def _flat(stages):
    """{STAGE:NAME: number}; -1 of an opening's distance says that none was seen."""
    flat = {}
    for stage, values in stages.items():
        for name, value in values.items() if isinstance(values, dict) else ():
            if isinstance(value, (int, float)) and not (name.startswith("loop_mm") and value < 0):
                flat[f"{stage}:{name}"] = float(value)
    if "evidence:scan_to_surface_mm" not in flat:
        flat.pop("evidence:observed", None)  # nothing can be found on a scan that is not there
    return flat


def _seconds(run):
    """{frame: {seconds:STAGE: s}}, the last of each stage, and their sum."""
    found: dict[int, dict[str, float]] = {}
    for line in run.status.lines():
        if line.get("ok") and isinstance(line.get("frame"), int) and isinstance(line.get("seconds"), (int, float)):
            found.setdefault(line["frame"], {})[f"seconds:{line['stage']}"] = float(line["seconds"])
    return {frame: values | {"seconds:all": sum(values.values())} for frame, values in found.items()}


# what is made and kept ------------------------------------------------------------------------------------------------


def _between(run, prints, kept, progress):
    """{frame: {"of": what it was made of, "values"}} of the registered frames; made are those that have changed."""
    made, work, ok = {}, Between(run), run.ok
    for i, number in enumerate(ok):
        near = [
            prints.get(n, "") for n in (number - 1, number, number + 1, ok[0])
        ]  # the first says what lies under what
        known = kept.get(str(number), {})
        if not prints[number] or known.get("of") != near:
            known = {"of": near, "values": {name: float(f"{v:.6g}") for name, v in work.measures(number).items()}}
            if progress is not None:
                progress("neighbours", i + 1, len(ok))
        made[str(number)] = known
    return made


def _truth(run, prints, kept):
    """{"of", "result" of `evaluate`} where the capture has a truth, its "result" a warning where that cannot be read; {} elsewhere."""
    try:
        truth = open_truth(run.capture)
    except UserError as error:
        return {"result": {"warnings": [str(error)]}}
    if truth is None:
        return {}
    stamp = (truth.path / "zarr.json").stat()
    of = _fingerprint({"frames": [*prints.values()], "truth": [stamp.st_size, stamp.st_mtime_ns]})
    known = all(prints.values()) and kept.get("of") == of
    return kept if known else {"of": of, "result": json.loads(json.dumps(evaluate(run)))}


def _fingerprint(stages):
    """Of a frame's diagnostics, whose numbers change with every vertex; "" without any."""
    return hashlib.sha256(json.dumps(stages, sort_keys=True).encode()).hexdigest()[:16] if stages else ""


def _read(run):
    """What was kept by this version; {} where there is nothing, or nothing that can be read."""
    path = run.path / KEPT
    try:
        kept = read_json(path, dict) if path.exists() else {}
    except UserError:
        return {}
    return kept if kept.get("version") == __version__ else {}


def _keep(run, kept):
    try:
        write_text(run.path / KEPT, json.dumps(kept))
    except OSError:
        pass  # another's run: it is measured again next time
