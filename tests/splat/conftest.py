"""Array types for the tests of splat, which need no path tracer."""

from __future__ import annotations

import pytest

import splat  # noqa: F401  (before drjit: it points Dr.Jit to a usable LLVM)


@pytest.fixture(scope="session")
def arrays():
    """CUDA if available, else LLVM."""
    import drjit as dr

    from splat.base.arrays import Arrays

    return Arrays("cuda" if dr.has_backend(dr.JitBackend.CUDA) else "llvm")
