"""The splats live on the device that Mitsuba uses."""

from __future__ import annotations

import mitsuba as mi
import pytest

from hybrid.base.compute_device import device_arrays
from pathtrace.scene import backend as backend_module

pytestmark = pytest.mark.usefixtures("backend")


@pytest.mark.parametrize(("variant", "expected"), [("llvm_ad_rgb", "llvm"), ("cuda_ad_rgb", "cuda")])
def test_arrays_are_those_of_mitsubas_variant(variant, expected, monkeypatch):
    monkeypatch.setattr(mi, "variant", lambda: variant)
    monkeypatch.setattr(backend_module, "_selected", None)
    arrays = device_arrays()
    assert arrays.backend == expected
    assert arrays.plain.__name__ == f"drjit.{expected}"
