"""Pickles of arrays are read, pickles of anything else are not."""

from __future__ import annotations

import io
import os
import pickle

import numpy as np
import pytest

from hybrid.measure.perceptual_metrics import ArrayUnpickler


def test_nested_arrays_are_read():
    held = {"layer": {"kernel": np.arange(6.0).reshape(2, 3), "bias": np.zeros(0, np.float32)}, "n": 3}
    read = ArrayUnpickler(io.BytesIO(pickle.dumps(held))).load()
    np.testing.assert_array_equal(read["layer"]["kernel"], held["layer"]["kernel"])
    assert read["layer"]["bias"].dtype == np.float32
    assert read["n"] == 3


@pytest.mark.parametrize("content", [print, os.system, np.load, pickle.Unpickler])
def test_code_is_refused(content):
    with pytest.raises(pickle.UnpicklingError, match="is not an array"):
        ArrayUnpickler(io.BytesIO(pickle.dumps({"a": content}))).load()
