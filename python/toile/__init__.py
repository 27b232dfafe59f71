"""toile: captured, clothed people registered as layers, the body and each garment, in fixed topologies.

`toile.kernels` holds the solvers, `toile.scene` the types, `toile.register` runs the whole chain.
"""

import os
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

# Threads that spin while they wait cost others on a busy machine four times their time. OpenMP reads this as it loads.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

from . import kernels

if TYPE_CHECKING:
    from .io.body import load_body_model as load_body_model
    from .io.capture import open_capture as open_capture
    from .io.mesh import read_mesh as read_mesh
    from .io.mesh import write_mesh as write_mesh
    from .io.run import Run as Run
    from .io.run import open_run as open_run
    from .pipeline.outcome import Outcome as Outcome
    from .pipeline.run import register as register

try:
    __version__ = version("toile")
except PackageNotFoundError:  # run from the source tree
    __version__ = "0+source"

# loaded when they are first asked for, so that the kernels alone stay light
_HOMES = {
    "open_capture": "io.capture",
    "open_run": "io.run",
    "Run": "io.run",
    "register": "pipeline.run",
    "Outcome": "pipeline.outcome",
    "load_body_model": "io.body",
    "read_mesh": "io.mesh",
    "write_mesh": "io.mesh",
}
__all__ = ["__version__", "kernels", *_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'toile' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
