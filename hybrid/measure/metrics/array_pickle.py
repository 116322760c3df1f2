"""Reads pickles of NumPy arrays without running code."""

from __future__ import annotations

import pickle
from typing import Any


class ArrayUnpickler(pickle.Unpickler):
    """Reads pickles of NumPy arrays; refuses everything else, because it could run code.

    Raises:
        pickle.UnpicklingError: while loading, if the pickle contains anything but arrays.
    """

    _ALLOWED = frozenset(
        [
            ("numpy.core.multiarray", "_reconstruct"),
            ("numpy._core.multiarray", "_reconstruct"),
            ("numpy", "ndarray"),
            ("numpy", "dtype"),
        ]
    )

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._ALLOWED:
            raise pickle.UnpicklingError(f"{module}.{name} in a pickle of arrays is not an array")
        return super().find_class(module, name)
