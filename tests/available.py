"""The backends that are present, and the array types that tests without a path tracer use."""

from __future__ import annotations

from compose.base.arrays import Arrays, BackendName  # isort: skip  (before drjit: it points Dr.Jit to a usable LLVM)
import drjit as dr


def available_backends() -> list[BackendName]:
    """The backends that are present; CUDA first."""
    return ["cuda", "llvm"] if dr.has_backend(dr.JitBackend.CUDA) else ["llvm"]


def available_arrays() -> Arrays:
    """CUDA if available, else LLVM."""
    return Arrays(available_backends()[0])
