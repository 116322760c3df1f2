"""Which backend is selected, and what is reported where none works."""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys

import drjit as dr
import mitsuba as mi
import pytest

import pathtrace.scene.backend as module
from compose.base.errors import UserError
from pathtrace.scene.backend import CUDA_VARIANT, LLVM_VARIANT, select_backend
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer
from tests import small


@pytest.fixture
def unselected(backend, monkeypatch):
    """As in a new process on a machine without CUDA; the variant of the test run is restored afterwards."""
    monkeypatch.setattr(module, "_selected", None)
    monkeypatch.setattr(module, "_cuda_works", lambda: False)
    yield monkeypatch
    mi.set_variant(backend.variant)


def test_unknown_and_other_choices_are_refused(backend):
    with pytest.raises(UserError, match=r"^backend metal: must be auto, cuda or llvm$"):
        select_backend("metal")
    other = "cuda" if backend.variant == LLVM_VARIANT else "llvm"
    with pytest.raises(UserError, match=f"^backend {other}: {backend.variant} is already in use$"):
        select_backend(other)


def test_the_first_choice_stays(backend):
    same = "llvm" if backend.variant == LLVM_VARIANT else "cuda"
    assert select_backend() is select_backend("auto") is select_backend(same) is backend
    assert mi.variant() == backend.variant


@pytest.mark.parametrize(("choice", "reason"), [("llvm", "as requested"), ("auto", "no CUDA device")])
def test_llvm_is_used_without_cuda(unselected, choice, reason):
    selected = select_backend(choice)
    assert selected.variant == mi.variant() == LLVM_VARIANT
    assert selected.llvm is module.LLVM
    assert reason in selected.reason


@pytest.mark.parametrize("choice", ["cuda", "auto"])
def test_cuda_is_used_if_it_works(unselected, choice):
    unselected.setattr(module, "_cuda_works", lambda: True)
    selected = select_backend(choice)
    assert (selected.variant, selected.llvm) == (CUDA_VARIANT, None)


def test_llvm_can_be_chosen_although_cuda_works(unselected):
    unselected.setattr(module, "_cuda_works", lambda: True)
    assert select_backend("llvm").variant == LLVM_VARIANT


def test_cuda_that_does_not_work_is_refused(unselected):
    with pytest.raises(UserError, match=r"^backend cuda: no CUDA device"):
        select_backend("cuda")
    # A refused choice does not count as the first one.
    assert select_backend("llvm").variant == LLVM_VARIANT


def test_a_missing_llvm_is_reported_unless_cuda_works(unselected):
    unselected.setattr(module, "LLVM", UserError("no LLVM found"))
    unselected.setattr(ctypes.util, "find_library", lambda name: None)
    for choice in ("llvm", "auto"):
        with pytest.raises(UserError, match="no LLVM found"):
            select_backend(choice)
    unselected.setattr(ctypes.util, "find_library", lambda name: f"lib{name}.so")
    with pytest.raises(UserError, match="no LLVM found"):
        select_backend("auto")
    unselected.setattr(module, "_cuda_works", lambda: True)
    assert select_backend("auto").variant == CUDA_VARIANT


def test_an_old_llvm_that_was_loaded_before_is_reported(unselected):
    unselected.setattr(dr.detail, "llvm_version", lambda: (18, 1, 0))
    with pytest.raises(UserError, match="loaded LLVM 18; import hybrid before drjit"):
        select_backend("llvm")
    unselected.setattr(dr.detail, "llvm_version", lambda: (19, 1, 0))
    assert select_backend("llvm").variant == LLVM_VARIANT


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_fork_is_refused_at_once(backend, tmp_path):
    """Where Dr.Jit would wait for threads that are not there."""
    script = """
import os
import hybrid
from pathtrace.trace.tracer import Tracer
scene = hybrid.load_scene("cornell")
child = os.fork()
if not child:
    said = []
    for use in (lambda: hybrid.load_scene("cornell"), lambda: Tracer(scene)):
        try:
            use()
        except hybrid.UserError as error:
            said.append("is a fork of one that renders" in str(error))
    os._exit(0 if said == [True, True] else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), Tracer(scene).scene is scene)
"""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "HYBRID_HOME": str(tmp_path),
    }
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True, env=environment)
    assert done.stdout.split() == ["0", "True"]


def test_another_variant_is_named_and_put_right_by_loading(backend):
    scene = load_scene(small.corner())
    mi.set_variant("scalar_rgb")
    try:
        with pytest.raises(
            UserError, match=rf"variant is scalar_rgb.* mitsuba.set_variant\('{backend.variant}'\)"
        ):
            Tracer(scene)
        assert select_backend() is backend
        assert mi.variant() == backend.variant
        assert Tracer(scene).scene is scene
    finally:
        mi.set_variant(backend.variant)
