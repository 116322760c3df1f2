"""Threads of the two libraries that compute on the CPU, on the same cores."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr


@contextmanager
def torch_alone() -> Iterator[None]:
    """Ends Dr.Jit's worker threads for a while: they spin while they wait, and torch's need their cores.

    Fusing a disc takes a quarter less so; ending and starting the threads takes a tenth of a millisecond.
    """
    before = dr.thread_count()
    dr.set_thread_count(1)
    try:
        yield
    finally:
        dr.set_thread_count(before)
