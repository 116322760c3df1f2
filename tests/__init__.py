"""Tests; each process of pytest-xdist, and what it starts, has cores of its own.

Otherwise each has a thread per core, in Dr.Jit and in torch, which wait for each other half of the time. This
must come before anything starts its threads.
"""

import os

_worker, _count = (os.environ.get(f"PYTEST_XDIST_WORKER{part}") for part in ("", "_COUNT"))
if _worker and _count and hasattr(os, "sched_setaffinity"):
    _cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, _cores[int(_worker.removeprefix("gw")) :: int(_count)] or _cores)
