"""Chooses and checks the Mitsuba variant; if something is missing, says what to install.

The variant is Mitsuba's own global state and the only one in the project; only this module sets it.
"""

from __future__ import annotations

import ctypes.util
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from compose import LLVM
from compose.base.errors import UserError
from compose.base.startup import MINIMUM_LLVM, Llvm

LLVM_VARIANT = "llvm_ad_rgb"
CUDA_VARIANT = "cuda_ad_rgb"
# Mitsuba reads EXR files in Dr.Jit's threads; with one, which is the caller, it would wait for ever.
_THREADS_TO_READ = 2


@dataclass(frozen=True)
class Backend:
    """The selected Mitsuba variant, the LLVM that compiles for it (None on CUDA), and, for people, why."""

    variant: str
    llvm: Llvm | None
    reason: str


_selected: Backend | None = None
_process = 0


def select_backend(choice: str = "auto") -> Backend:
    """Sets the Mitsuba variant, once per process: "cuda", "llvm", or "auto" for CUDA if it is available.

    UserError if the choice is unknown or not available, or another backend is already in use.
    """
    global _selected, _process
    _require_own_process()
    if choice not in ("auto", "cuda", "llvm"):
        raise UserError(f"backend {choice}: must be auto, cuda or llvm")
    if _selected is not None:
        wanted = {"cuda": CUDA_VARIANT, "llvm": LLVM_VARIANT, "auto": _selected.variant}[choice]
        if wanted != _selected.variant:
            raise UserError(f"backend {choice}: {_selected.variant} is already in use")
        import mitsuba as mi

        # Somebody else may have set another one meanwhile.
        mi.set_variant(_selected.variant)
        return _selected
    _selected, _process = _select(choice), os.getpid()
    return _selected


@contextmanager
def threads_to_read() -> Iterator[None]:
    """Has as many threads as it takes to read files, where there are fewer."""
    import drjit as dr

    before = dr.thread_count()
    dr.set_thread_count(max(before, _THREADS_TO_READ))
    try:
        yield
    finally:
        dr.set_thread_count(before)


def require_backend() -> None:
    """UserError where nothing can be traced: in a fork, or if Mitsuba's variant is another one by now."""
    _require_own_process()
    import mitsuba as mi

    if _selected is not None and mi.variant() != _selected.variant:
        raise UserError(
            f"Mitsuba's variant is {mi.variant()}, set since the scene was loaded; call "
            f"mitsuba.set_variant({_selected.variant!r}) before going on"
        )


def _require_own_process() -> None:
    """UserError in a fork of the process that selected the backend: Dr.Jit's threads are not in it."""
    if _process not in (0, os.getpid()):
        raise UserError(
            "this process is a fork of one that renders, in which Dr.Jit would wait for ever; start "
            'processes with multiprocessing.get_context("spawn")'
        )


def _select(choice: str) -> Backend:
    if isinstance(LLVM, UserError) and (choice == "llvm" or not ctypes.util.find_library("cuda")):
        raise LLVM
    import drjit as dr
    import mitsuba as mi

    # Plugins are native code: those in a folder `plugins` of the working folder are not Mitsuba's.
    mi.file_resolver().prepend(str(Path(mi.__file__).parent))  # type: ignore[operator]  # a function
    # More talkative levels deadlock with a second thread in Dr.Jit 1.5.
    dr.set_log_level(dr.LogLevel.Warn)
    if choice != "llvm" and _cuda_works():
        return Backend(CUDA_VARIANT, None, "a CUDA device with OptiX is available")
    if choice == "cuda":
        raise UserError("backend cuda: no CUDA device with OptiX is available; use llvm")
    if isinstance(LLVM, UserError):
        raise LLVM
    loaded = dr.detail.llvm_version()[0]
    if loaded < MINIMUM_LLVM:
        raise UserError(f"Dr.Jit was imported first and loaded LLVM {loaded}; import hybrid before drjit")
    mi.set_variant(LLVM_VARIANT)
    reason = "as requested" if choice == "llvm" else "no CUDA device with OptiX is available"
    return Backend(LLVM_VARIANT, LLVM, reason)


def _cuda_works() -> bool:
    """Whether Mitsuba can trace on CUDA; if so, its variant is set."""
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.CUDA):
        return False
    import mitsuba as mi

    try:
        mi.set_variant(CUDA_VARIANT)
        # Loading a scene also loads OptiX: some drivers can compute but not trace.
        mi.load_dict({"type": "scene", "shape": {"type": "sphere"}})
        return bool(dr.all(dr.arange(mi.Float, 2) + 1 > 0))
    except Exception:  # whatever the driver raises, the CPU remains
        return False
