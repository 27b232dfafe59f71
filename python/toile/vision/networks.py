"""Networks in ONNX files, run by onnxruntime on the processor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError, first_line
from ..io.bounded import check_file

MODEL_BYTES = 4 << 30


def open_network(path: Path, threads: int = 0) -> Any:
    """The session of an ONNX file; `threads` 0 for as many as processors. UserError: none, or one that cannot be read."""
    check_file(path, MODEL_BYTES)
    try:
        import onnxruntime
    except ImportError:
        raise UserError(f"{path}: a network needs onnxruntime: pip install 'toile[detect]'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise UserError(f"{path}: cannot be read as an ONNX network: {first_line(error)}") from None


def run_network(path: Path, session: Any, picture: Any) -> list[Any]:
    """All outputs for a normalised picture (3,H,W)."""
    input = session.get_inputs()[0]
    kind = np.float16 if input.type == "tensor(float16)" else np.float32
    try:
        return list(session.run(None, {input.name: picture[None].astype(kind)}))
    except Exception as error:
        raise UserError(f"{path}: does not run: {first_line(error)}") from None
