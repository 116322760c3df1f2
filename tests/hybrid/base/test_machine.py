"""The machine on which results are measured."""

from __future__ import annotations

import json
import os
from importlib.metadata import version
from pathlib import Path

import mitsuba as mi
import pytest

from hybrid.base import identity as module
from hybrid.base.identity import machine

pytestmark = pytest.mark.usefixtures("backend")


@pytest.fixture
def proc(monkeypatch, tmp_path):
    """An empty folder in place of /proc."""
    monkeypatch.setattr(module, "Path", lambda path: tmp_path / Path(path).relative_to("/proc"))
    return tmp_path


def test_everything_that_times_depend_on_is_there(backend):
    found = machine()
    assert found["backend"] == backend.variant
    assert found["cores"] == len(os.sched_getaffinity(0))
    assert found["packages"]["drjit"] == version("drjit")
    assert {*found["packages"]} == {"mitsuba", "drjit", "torch", "numpy"}
    assert found["version"] == version("foveated-hybrid-renderer")
    assert found["cpu"]
    assert json.loads(json.dumps(found)) == found


def test_the_processor_is_the_first_one_of_cpuinfo(proc):
    (proc / "cpuinfo").write_text("processor\t: 0\nmodel name\t: Fast CPU: 3 GHz\n\nmodel name\t: Slow CPU\n")
    assert machine()["cpu"] == "Fast CPU: 3 GHz"


def test_without_cpuinfo_the_platform_names_the_processor(proc, monkeypatch):
    monkeypatch.setattr(module.platform, "processor", lambda: "")
    monkeypatch.setattr(module.platform, "machine", lambda: "arm64")
    assert machine()["cpu"] == "arm64"


def test_the_graphics_card_matters_on_its_backend_only(proc, monkeypatch):
    cards = proc / "driver" / "nvidia" / "gpus"
    for number, name in enumerate(("First", "Second")):
        (cards / f"000{number}").mkdir(parents=True)
        (cards / f"000{number}" / "information").write_text(f"IRQ: 12\nModel: \t {name} Card\n")
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    assert machine()["gpu"] == "First Card"
    monkeypatch.setattr(mi, "variant", lambda: "llvm_ad_rgb")
    assert machine()["gpu"] is None


def test_a_driver_that_names_no_card_is_no_error(proc, monkeypatch):
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    assert machine()["gpu"] is None
