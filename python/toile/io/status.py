"""RUN/status.jsonl: what every stage did, a line a stage and frame, and what was warned of."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .files import naming


class Status:
    """Lines {"frame", "stage", "seconds", "ok", ..., "time"} in the order in which they were added, by however many processes;
    `time` is when [s since 1970]."""

    def __init__(self, path: Path):
        self.path = path

    @staticmethod
    def of(run: Path | str) -> Status:
        """The status of a run's folder."""
        return Status(Path(run) / "status.jsonl")

    def add(self, **line: Any) -> None:
        text = json.dumps(line | {"time": round(time.time(), 2)}) + "\n"
        with naming(self.path), open(self.path, "a+b") as file:
            file.seek(0, os.SEEK_END)
            if file.tell():
                file.seek(-1, os.SEEK_END)
                text = text if file.read(1) == b"\n" else f"\n{text}"  # a full disk or a kill cut the last line
            file.write(text.encode())

    @contextmanager
    def timing(self, frames: int, **line: Any) -> Iterator[Callable[[], None]]:
        """Adds the line with what the block took, `seconds` and the processor's, `cpu`, where it ends well. It is given a
        function to call as each of its frames ends: from the first end to the last call one of them takes `each_seconds`
        and `each_cpu`, without what is built with the first."""
        now = lambda: (time.perf_counter(), time.process_time())
        marks = [now()]

        def ends() -> None:
            marks.append(now())

        yield ends
        ends()
        span = lambda i, j, k: marks[j][k] - marks[i][k]
        line |= {"frames": frames, "seconds": span(0, -1, 0), "cpu": span(0, -1, 1)}
        if frames > 1 and len(marks) > 3:
            line |= {"each_seconds": span(1, -2, 0) / (frames - 1), "each_cpu": span(1, -2, 1) / (frames - 1)}
        self.add(**line, ok=True)

    def lines(self) -> Iterator[dict[str, Any]]:
        """All whole lines; a run that was killed may have left the last one cut."""
        for text in self.path.read_text(encoding="utf-8", errors="replace").splitlines() if self.path.exists() else []:
            try:
                line = json.loads(text)
            except (ValueError, RecursionError):
                continue
            if isinstance(line, dict):
                yield line

    def forget(self, stage: str) -> None:
        """What this stage has warned of no longer holds: it is done again."""
        if any(line.get("stage") == stage and "warning" in line for line in self.lines()):
            self.add(stage=stage, ok=True, again=True)

    def warnings(self) -> list[str]:
        """What was warned of and holds, each once."""
        found: dict[Any, dict[str, None]] = {}
        for line in self.lines():
            if line.get("again"):
                found.pop(line.get("stage"), None)
            elif "warning" in line:
                found.setdefault(line.get("stage"), {})[line["warning"]] = None
        return list(dict.fromkeys(warning for warnings in found.values() for warning in warnings))
