"""`hybrid doctor`: checks the installation and says what to install if something is missing."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from compose.base.errors import UserError
from hybrid.cli import options as o

_PACKAGES = ("mitsuba", "drjit", "mitsuba-oidn", "embreex", "torch", "numpy", "OpenEXR", "safetensors")


def doctor(backend: o.Backend = "auto", json_file: o.Json = None) -> None:
    """Say which backend runs, why, and what to install if something is missing."""
    facts, problem = examine(backend)
    for name, value in facts.items():
        print(f"{name}: {value}")
    o.write_json(json_file, facts)
    if problem:
        raise UserError(problem)


def examine(choice: str) -> tuple[dict[str, Any], str | None]:
    """Lists the versions of the installed packages, selects the backend and runs a kernel on it.

    Versions, backend and hardware by name; and what is wrong and how to fix it, None if everything works.
    """
    facts: dict[str, Any] = {}
    for package in _PACKAGES:
        try:
            facts[package] = version(package)
        except PackageNotFoundError:
            facts[package] = "missing"
    facts |= {"python": platform.python_version(), "cores": len(os.sched_getaffinity(0))}
    missing = [package for package in _PACKAGES if facts[package] == "missing"]
    if missing:
        return facts, f"missing packages; run: pip install {' '.join(missing)}"
    from pathtrace.scene.backend import select_backend

    try:
        backend = select_backend(choice)
    except UserError as error:
        return facts, str(error)
    import drjit as dr
    import mitsuba as mi

    facts |= {"backend": backend.variant, "why": backend.reason, "threads": dr.thread_count()}
    if backend.llvm is not None:
        facts["llvm"] = f"{'.'.join(map(str, dr.detail.llvm_version()))} ({backend.llvm.path})"
    facts["kernel"] = "runs" if float(dr.sum(dr.arange(mi.Float, 4) + 1)[0]) == 10 else "wrong result"
    return facts, None
