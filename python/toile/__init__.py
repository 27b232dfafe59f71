"""toile: captured, clothed people registered as layers, the body and each garment, in fixed topologies.

`toile.kernels` holds the solvers, `toile.scene` the types, `toile.pipeline` the whole chain.
"""

from importlib.metadata import PackageNotFoundError, version

from . import kernels

try:
    __version__ = version("toile")
except PackageNotFoundError:  # run from the source tree
    __version__ = "0+source"

__all__ = ["__version__", "kernels"]
