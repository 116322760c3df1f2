"""The machine and the software on which results are measured."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mitsuba as mi

_PACKAGES = ("mitsuba", "drjit", "torch", "numpy")
_DISTRIBUTION = "foveated-hybrid-renderer"


def machine() -> dict[str, Any]:
    """Everything that measured times depend on: hardware, backend and software versions.

    Returns:
        cpu, cores, gpu (None on the CPU backend), backend (Mitsuba's variant), python, version (of this
        project), packages (name to version).
    """
    backend = mi.variant()
    return {
        "cpu": _first_value(Path("/proc/cpuinfo"), "model name")
        or platform.processor()
        or platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "gpu": _gpu() if str(backend).startswith("cuda") else None,
        "backend": backend,
        "python": platform.python_version(),
        "version": version(_DISTRIBUTION),
        "packages": {name: version(name) for name in _PACKAGES},
    }


def _gpu() -> str | None:
    """Name of the first NVIDIA GPU; None if the driver does not report it."""
    cards = sorted(Path("/proc/driver/nvidia/gpus").glob("*/information"))
    return _first_value(cards[0], "Model") if cards else None


def _first_value(file: Path, name: str) -> str | None:
    """Value of the first line `name : value` of a file; None if there is none."""
    try:
        lines = file.read_text().splitlines()
    except OSError:
        return None
    pairs = (line.split(":", 1) for line in lines if ":" in line)
    return next((value.strip() for key, value in pairs if key.strip() == name), None)
