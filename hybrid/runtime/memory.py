"""How unused memory returns to the operating system."""

from __future__ import annotations

import ctypes

import drjit as dr


def release_memory() -> None:
    """Releases the memory that Dr.Jit and the C library keep for reuse.

    This takes a few milliseconds, and about as many again when the memory is next needed.
    """
    dr.flush_malloc_cache()
    # Specific to glibc; other C libraries release memory by themselves.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
