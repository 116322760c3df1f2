"""The array types of the device that tests without a path tracer run on."""

from __future__ import annotations

from compose.base.arrays import Arrays  # isort: skip  (before drjit: it points Dr.Jit to a usable LLVM)
import drjit as dr


def available_arrays() -> Arrays:
    """CUDA if available, else LLVM."""
    return Arrays("cuda" if dr.has_backend(dr.JitBackend.CUDA) else "llvm")
