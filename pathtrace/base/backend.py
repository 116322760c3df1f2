"""Chooses and checks the Mitsuba variant, and says what to install where something is missing.

The variant is the project's one global state (Mitsuba's own), and this is the one place that sets it.
"""

from __future__ import annotations

import ctypes.util
from dataclasses import dataclass

from compose import LLVM
from compose.base.errors import UserError
from compose.base.llvm import MINIMUM_LLVM, Llvm

LLVM_VARIANT = "llvm_ad_rgb"
CUDA_VARIANT = "cuda_ad_rgb"


@dataclass(frozen=True)
class Backend:
    """What runs the kernels: the Mitsuba variant, the LLVM used by it (None on CUDA), and why."""

    variant: str
    llvm: Llvm | None
    reason: str


def _cuda_works() -> bool:
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.CUDA):
        return False
    import mitsuba as mi

    try:
        mi.set_variant(CUDA_VARIANT)
        # Loads OptiX as well: a driver without it can compute, but it cannot trace.
        mi.load_dict({"type": "scene", "shape": {"type": "sphere"}})
        return bool(dr.all(dr.arange(mi.Float, 2) + 1 > 0))
    except Exception:  # whatever the driver throws, the CPU is there
        return False


_selected: Backend | None = None


def select_backend(choice: str = "auto") -> Backend:
    """Sets the Mitsuba variant once per process: CUDA where it works, else LLVM.

    Args:
        choice: "auto", "cuda" or "llvm".

    Raises:
        UserError: the choice is unknown, cannot work here, or another one was made before.
    """
    global _selected
    if choice not in ("auto", "cuda", "llvm"):
        raise UserError(f"--backend {choice}: must be auto, cuda or llvm")
    if _selected is not None:
        wanted = {"cuda": CUDA_VARIANT, "llvm": LLVM_VARIANT, "auto": _selected.variant}[choice]
        if wanted != _selected.variant:
            raise UserError(f"--backend {choice}: {_selected.variant} is already in use")
        return _selected
    _selected = _select(choice)
    return _selected


def _select(choice: str) -> Backend:
    if isinstance(LLVM, UserError) and (choice == "llvm" or not ctypes.util.find_library("cuda")):
        raise LLVM
    import drjit as dr
    import mitsuba as mi

    # More talkative levels deadlock with a second thread in Dr.Jit 1.5.
    dr.set_log_level(dr.LogLevel.Warn)
    if choice != "llvm" and _cuda_works():
        return Backend(CUDA_VARIANT, None, "a CUDA device with OptiX answers")
    if choice == "cuda":
        raise UserError("--backend cuda: no CUDA device with OptiX answers here; use --backend llvm")
    if isinstance(LLVM, UserError):
        raise LLVM
    loaded = dr.detail.llvm_version()[0]
    if loaded < MINIMUM_LLVM:
        raise UserError(f"Dr.Jit was imported first and took LLVM {loaded}; import hybrid before drjit")
    mi.set_variant(LLVM_VARIANT)
    asked = choice == "llvm"
    return Backend(LLVM_VARIANT, LLVM, "asked for" if asked else "no CUDA device with OptiX answers")
