"""The doctor names what is installed, what runs, and what is missing."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

import drjit as dr
import pytest

from hybrid.base import installation as doctor

pytestmark = pytest.mark.usefixtures("backend")


def test_a_working_installation_has_facts_and_no_problem(backend):
    report = doctor.examine("auto")
    assert report.problem is None
    assert report.facts["backend"] == backend.variant
    assert report.facts["why"] == backend.reason
    assert report.facts["kernel"] == "runs"
    assert report.facts["torch"] == version("torch")
    assert report.facts["python"] == platform.python_version()
    assert report.facts["cores"] == len(os.sched_getaffinity(0))
    assert report.facts["threads"] == dr.thread_count()
    # On CUDA there is no LLVM to name.
    assert ("llvm" in report.facts) == (backend.llvm is not None)
    if backend.llvm is not None:
        assert report.facts["llvm"].endswith(f" ({backend.llvm.path})")
        assert report.facts["llvm"].startswith(f"{dr.detail.llvm_version()[0]}.")
    assert f"numpy: {version('numpy')}" in report.lines()


def test_missing_packages_are_named_with_the_command_that_installs_them(monkeypatch):
    def incomplete(package: str) -> str:
        if package in ("torch", "OpenEXR"):
            raise PackageNotFoundError(package)
        return version(package)

    monkeypatch.setattr(doctor, "version", incomplete)
    report = doctor.examine("auto")
    assert report.problem == "missing packages; run: pip install torch OpenEXR"
    assert report.facts["torch"] == "missing"
    assert "backend" not in report.facts


def test_a_backend_that_is_not_available_is_the_problem():
    report = doctor.examine("metal")
    assert report.problem == "backend metal: must be auto, cuda or llvm"
    assert "kernel" not in report.facts


def test_facts_that_do_not_apply_are_not_listed():
    assert doctor.Report({"cores": 2, "gpu": None, "why": "asked"}).lines() == ["cores: 2", "why: asked"]
