"""Memory that nothing needs any more."""

from __future__ import annotations

import ctypes

import drjit as dr


def give_back() -> None:
    """Dr.Jit and the C library keep memory that was freed for the next time; now others may have it.

    Some milliseconds, and as many more until what is needed again has been had.
    """
    dr.flush_malloc_cache()
    # Only glibc has it; others give back by themselves.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
