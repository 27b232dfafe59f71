"""Solvers that travel between processes: as what they were made of."""

from typing import Any

import numpy as np


class Rebuilt:
    """Pickles and copies as its class and arguments, and is then made anew: factors and trees are never written, and the
    bits of what it solves stay."""

    def _keep(self, *arguments: Any, **options: Any) -> None:
        """Keeps the arguments of the constructor; arrays are copied, as the caller may change them."""
        self._arguments = [np.array(a) if isinstance(a, np.ndarray) else a for a in arguments], options

    def __reduce__(self) -> tuple[Any, ...]:
        return _make, (type(self), *self._arguments)


def _make(kind: Any, arguments: list[Any], options: dict[str, Any]) -> Any:
    return kind(*arguments, **options)
