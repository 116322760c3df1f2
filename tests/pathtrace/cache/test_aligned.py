"""Arrays of Dr.Jit's own."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.cache.aligned import aligned

pytestmark = pytest.mark.usefixtures("backend")


@pytest.mark.parametrize("offset", range(4))
def test_arrays_lie_where_kernels_expect_them_wherever_they_come_from(offset):
    values = np.arange(70, dtype=np.float32)[offset:]
    copy, other = aligned(values, values.astype(float).reshape(-1, 1))
    for found in (copy, other):
        np.testing.assert_array_equal(found.numpy(), values)
        assert found.numpy().ctypes.data % 64 == 0
    values[:] = 0
    assert copy.numpy().any()
