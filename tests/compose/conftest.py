"""Array types for the tests of compose, which need no path tracer."""

from __future__ import annotations

import pytest

from compose.base.arrays import Arrays
from tests.available import available_arrays


@pytest.fixture(scope="session")
def arrays() -> Arrays:
    """CUDA if available, else LLVM."""
    return available_arrays()
