"""toile: captured, clothed people registered as layers, the body and each garment, in fixed topologies.

`toile.kernels` holds the solvers, `toile.scene` the types, `toile.pipeline` the whole chain.
"""

import os
from importlib.metadata import PackageNotFoundError, version

# Threads that spin while they wait cost others on a busy machine four times their time. OpenMP reads this as it loads.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

from . import kernels  # noqa: E402

try:
    __version__ = version("toile")
except PackageNotFoundError:  # run from the source tree
    __version__ = "0+source"

__all__ = ["__version__", "kernels"]
