"""Whole frames by mode and size: wall clock, kernels, and the bytes that pass through the host."""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import import_module
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.errors import MOST_SEED
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from hybrid.base.compute_device import device_arrays
from hybrid.base.progress import Steps
from hybrid.measure.frame_times import gaze_path, percentiles
from hybrid.render.frame_renderer import LiveRenderer, Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

# Points of the gaze path: from one frame to the next, the gaze moves by about a hundredth of the width.
_GAZES = 80
# Frames per case that are profiled, after the timed ones: Dr.Jit's history slows frames down.
_PROFILED = 5
# Places of two functions in the table of NumPy's C API, part of its ABI since NumPy 1.22 (NEP 49).
_SET_HANDLER, _GET_HANDLER = 304, 305
# Methods of Dr.Jit arrays that bring them to the host.
_TO_HOST = ("numpy", "to_numpy", "__array__")


class HostBytes:
    """Counts the bytes that pass through the host while the context is open, and those of the largest array.

    These are the sizes of all arrays that NumPy allocates on this thread, temporary ones included, each time
    that they are, and of arrays of the remote backend, out of the host's reach, that become NumPy arrays.

    Not counted are views, such as the NumPy arrays of Dr.Jit's on the CPU; single numbers (`array[0]`);
    uploads of memory that was allocated before, or by torch; and memory of torch, Dr.Jit, Mitsuba and OIDN on
    the CPU.
    """

    def __init__(self, remote: dr.JitBackend = dr.JitBackend.CUDA):
        self.count = self.largest = 0
        self._remote = remote
        self._methods = {name: getattr(dr.ArrayBase, name) for name in _TO_HOST}
        self._allocated = 0
        self._before: object = None

    def __enter__(self) -> HostBytes:
        allocator = _allocator()
        self._allocated, self._before = allocator.allocated, allocator.use(allocator.handler)
        allocator.largest = 0
        for name, method in self._methods.items():
            setattr(dr.ArrayBase, name, self._counted(method))
        return self

    def __exit__(self, *_: object) -> None:
        for name, method in self._methods.items():
            setattr(dr.ArrayBase, name, method)
        allocator = _allocator()
        allocator.use(self._before)
        self.count += allocator.allocated - self._allocated
        self.largest = max(self.largest, allocator.largest)

    def _counted(self, method: Callable[..., NDArray[Any]]) -> Callable[..., NDArray[Any]]:
        def counting(array: dr.ArrayBase, *args: object, **options: object) -> NDArray[Any]:
            copy = method(array, *args, **options)
            if dr.backend_v(array) == self._remote:
                self.count += copy.nbytes
                self.largest = max(self.largest, copy.nbytes)
            return copy

        return counting


# Functions in C: those that a handler consists of, and those that it is made and set with.
_Allocate = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
_AllocateZeros = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
_Reallocate = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
_Pointer = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)
_Capsule = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
_GetHandler = ctypes.PYFUNCTYPE(ctypes.py_object)
_SetHandler = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)


class _Handler(ctypes.Structure):
    """NumPy's `PyDataMem_Handler`. Its functions require the GIL, because NumPy keeps small blocks."""

    _fields_ = (
        ("name", ctypes.c_char * 127),
        ("version", ctypes.c_uint8),
        ("context", ctypes.c_void_p),
        ("malloc", _Allocate),
        ("calloc", _AllocateZeros),
        ("realloc", _Reallocate),
        ("free", ctypes.c_void_p),
    )


class _Allocator:
    """NumPy's own allocator of array data, with a count of the bytes that it is asked for (NEP 49).

    Attributes:
        allocated: bytes since the process began, while it was in use.
        largest: bytes of the largest piece of memory since this was last set to 0.
        use: makes NumPy allocate through a handler, such as its own, on this thread; returns the one before.
    """

    _NAME = b"mem_handler"

    def __init__(self) -> None:
        self.allocated = self.largest = 0
        python = ctypes.pythonapi
        pointer = _Pointer(("PyCapsule_GetPointer", python))
        capsule = _Capsule(("PyCapsule_New", python))
        # What every C extension imports to call NumPy.
        api = import_module("numpy._core._multiarray_umath")._ARRAY_API
        table = ctypes.cast(pointer(api, None), ctypes.POINTER(ctypes.c_void_p))
        self.use = _SetHandler(table[_SET_HANDLER] or 0)
        own = _GetHandler(table[_GET_HANDLER] or 0)()
        found = _Handler.from_address(pointer(own, self._NAME))
        counting = _Handler.from_buffer_copy(found)
        # Freeing stays as it is. The sizes are the last arguments.
        for name, kind, sizes in (
            ("malloc", _Allocate, 1),
            ("calloc", _AllocateZeros, 2),
            ("realloc", _Reallocate, 1),
        ):
            setattr(counting, name, kind(partial(self._counted, getattr(found, name), sizes)))
        # Arrays are freed through it until the very end of the process.
        python.Py_IncRef(ctypes.py_object(counting))
        self.handler = capsule(ctypes.addressof(counting), self._NAME, None)

    def _counted(self, allocate: Callable[..., object], sizes: int, *args: int) -> object:
        size = math.prod(args[-sizes:])
        self.allocated += size
        self.largest = max(self.largest, size)
        return allocate(*args)


_allocator = cache(_Allocator)


@dataclass(frozen=True)
class _Case:
    """Frames of one mode and size, by a renderer of their own: each keeps what depends on its camera."""

    renderer: Renderer
    settings: FrameSettings

    def frame(self, gaze: Gaze, seed: int) -> dict[str, float]:
        """Renders a complete frame; returns the milliseconds of its passes."""
        frame = self.renderer.frame(replace(self.settings, gaze=gaze), seed)
        dr.sync_thread()
        return frame.milliseconds


def bench_frame(
    scene: Scene,
    forest: Forest,
    settings: FrameSettings,
    sizes: Sequence[tuple[int, int]],
    repeats: int,
    warm_up: int,
    seed: int,
    progress: Steps,
) -> list[dict[str, Any]]:
    """One row per size, fovea mode and renderer; all take turns, the gaze moving and the camera still.

    The settings are those of the frames, apart from gaze, mode and size. Warm-up frames come before the
    `repeats` timed ones, profiled ones after them. Each frame has the next seed.

    Rows have mode; live, whether by the renderer of the window; width, height; wall_ms, percentiles of the
    milliseconds until a frame is complete; passes, those of each pass; backend, llvm or cuda; and medians:
    launches in Dr.Jit's history (kernels, reductions, sorts and, on the CPU, copies inside Dr.Jit),
    kernels_ms, the sum of their times, and host_bytes, as `HostBytes` counts.
    """
    cases = [
        _Case(kind(scene, forest), replace(settings, fovea=mode, camera=scene.camera.resized(*size)))
        for size in sizes
        for mode in FoveaMode
        for kind in (Renderer, LiveRenderer)
    ]
    timed: list[list[dict[str, float]]] = [[] for _ in cases]
    profiled: list[list[dict[str, float]]] = [[] for _ in cases]
    path, rounds = gaze_path(_GAZES), warm_up + repeats + _PROFILED
    for turn in range(rounds):
        gaze, number = path[turn % _GAZES], (seed + turn) % (MOST_SEED + 1)
        for index, case in enumerate(cases):
            if turn < warm_up:
                case.frame(gaze, number)
            elif turn < warm_up + repeats:
                start = time.perf_counter()
                passes = case.frame(gaze, number)
                timed[index].append({**passes, "wall": (time.perf_counter() - start) * 1000})
            else:
                profiled[index].append(_profile(case, gaze, number))
        progress(turn + 1, rounds)
    return [_row(*parts) for parts in zip(cases, timed, profiled, strict=True)]


def _profile(case: _Case, gaze: Gaze, seed: int) -> dict[str, float]:
    dr.sync_thread()
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory), HostBytes() as host:
        case.frame(gaze, seed)
    history = dr.kernel_history()
    milliseconds = sum(float(launch["execution_time"]) for launch in history)
    return {"kernels_ms": milliseconds, "launches": len(history), "host_bytes": host.count}


def _row(case: _Case, timed: list[dict[str, float]], profiled: list[dict[str, float]]) -> dict[str, Any]:
    camera = case.settings.camera or case.renderer.scene.camera
    times = {name: percentiles([frame[name] for frame in timed]) for name in timed[0]}
    return {
        "mode": case.settings.fovea.value,
        "live": isinstance(case.renderer, LiveRenderer),
        "width": camera.width,
        "height": camera.height,
        "wall_ms": times.pop("wall"),
        "kernels_ms": float(np.median([frame["kernels_ms"] for frame in profiled])),
        **{name: int(np.median([frame[name] for frame in profiled])) for name in ("launches", "host_bytes")},
        "passes": times,
        "backend": device_arrays().backend,
    }
