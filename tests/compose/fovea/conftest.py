"""Kernels that are asked with arrays of NumPy, and answer with them."""

from __future__ import annotations

import numpy as np
import pytest

from compose.fovea import adaptive
from tests.compose.arrays_of import channels, each_of, floats


@pytest.fixture
def allotted(arrays):
    """(D,) further samples, of worth and number of samples in NumPy."""

    def run(worth: np.ndarray, have: np.ndarray, total: int, seed: int) -> np.ndarray:
        given = floats(arrays, worth), floats(arrays, have)
        return each_of(adaptive.allotted(arrays, *given, total, seed), len(have))

    return run


@pytest.fixture
def disagreement(arrays):
    """(H, W) worth of further samples of two images of NumPy."""

    def run(denoised: np.ndarray, splat: np.ndarray) -> np.ndarray:
        shape = denoised.shape[:2]
        given = (channels(arrays, image.reshape(-1, 3)) for image in (denoised, splat))
        return np.array(adaptive.disagreement(arrays, *given, shape)).reshape(shape)

    return run
