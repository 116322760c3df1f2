"""The doctor names what is installed, what runs, and what is missing."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

import drjit as dr
import pytest

from hybrid.cli import doctor

pytestmark = pytest.mark.usefixtures("backend")


def test_a_working_installation_has_facts_and_no_problem(backend):
    facts, problem = doctor.examine("auto")
    assert problem is None
    assert facts["backend"] == backend.variant
    assert facts["why"] == backend.reason
    assert facts["kernel"] == "runs"
    assert facts["torch"] == version("torch")
    assert facts["python"] == platform.python_version()
    assert facts["cores"] == len(os.sched_getaffinity(0))
    assert facts["threads"] == dr.thread_count()
    # On CUDA there is no LLVM to name.
    assert ("llvm" in facts) == (backend.llvm is not None)
    if backend.llvm is not None:
        assert facts["llvm"].endswith(f" ({backend.llvm.path})")
        assert facts["llvm"].startswith(f"{dr.detail.llvm_version()[0]}.")


def test_missing_packages_are_named_with_the_command_that_installs_them(monkeypatch):
    def incomplete(package: str) -> str:
        if package in ("torch", "OpenEXR"):
            raise PackageNotFoundError(package)
        return version(package)

    monkeypatch.setattr(doctor, "version", incomplete)
    facts, problem = doctor.examine("auto")
    assert problem == "missing packages; run: pip install torch OpenEXR"
    assert facts["torch"] == "missing"
    assert "backend" not in facts


def test_a_backend_that_is_not_available_is_the_problem():
    facts, problem = doctor.examine("metal")
    assert problem == "backend metal: must be auto, cuda or llvm"
    assert "kernel" not in facts
