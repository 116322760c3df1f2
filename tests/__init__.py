"""Tests; what must be settled before anything starts threads, loads LLVM or compiles a kernel.

Each process of pytest-xdist, and what it starts, has cores of its own: otherwise each has a thread per core,
in Dr.Jit and in torch, which wait for each other half of the time.

Kernels are compiled without LLVM's optimizations and with its fastest allocation of registers: tests launch
thousands of kernels a few times each. They have a folder of their own, where the next run finds them, and
processes that tests start.

Shells have what they start in the background ignore Ctrl-C, and so would all processes that tests start.
"""

import ctypes
import os
import signal
from pathlib import Path

from compose import LLVM
from compose.base.errors import UserError

_worker, _count = (os.environ.get(f"PYTEST_XDIST_WORKER{part}") for part in ("", "_COUNT"))
if _worker and _count and hasattr(os, "sched_setaffinity"):
    _cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, _cores[int(_worker.removeprefix("gw")) :: int(_count)] or _cores)

signal.signal(signal.SIGINT, signal.default_int_handler)

if not isinstance(LLVM, UserError):
    _options = (
        b"tests",
        b"-opt-bisect-limit=0",
        b"-opt-bisect-verbose=false",
        b"-combiner-disabled",
        b"-optimize-regalloc=false",
        b"-regalloc=fast",
    )
    ctypes.CDLL(str(LLVM.path)).LLVMParseCommandLineOptions(
        len(_options), (ctypes.c_char_p * len(_options))(*_options), None
    )
    _kernels = Path(__file__).parents[1] / ".pytest_cache" / "kernels"
    _kernels.mkdir(parents=True, exist_ok=True)
    os.environ["DRJIT_CACHE_DIR"] = str(_kernels)
