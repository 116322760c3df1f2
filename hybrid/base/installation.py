"""Checks the installation and says what to install if something is missing."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from compose.base.errors import UserError

_PACKAGES = ("mitsuba", "drjit", "mitsuba-oidn", "embreex", "torch", "numpy", "OpenEXR", "safetensors")


@dataclass
class Report:
    """What an examination of the installation found.

    Attributes:
        facts: versions, backend and hardware by name; None for facts that do not apply.
        problem: what is wrong and how to fix it; None if everything works.
    """

    facts: dict[str, Any] = field(default_factory=dict)
    problem: str | None = None

    def lines(self) -> list[str]:
        """The facts that apply, one per line."""
        return [f"{name}: {value}" for name, value in self.facts.items() if value is not None]


def examine(choice: str) -> Report:
    """Lists the versions of the installed packages, selects the backend and runs a kernel on it.

    Args:
        choice: "auto", "cuda" or "llvm".
    """
    report = Report()
    facts = report.facts
    missing = []
    for package in _PACKAGES:
        try:
            facts[package] = version(package)
        except PackageNotFoundError:
            facts[package] = "missing"
            missing.append(package)
    facts["python"] = platform.python_version()
    facts["cores"] = len(os.sched_getaffinity(0))
    if missing:
        report.problem = f"missing packages; run: pip install {' '.join(missing)}"
        return report
    from pathtrace.scene.backend import select_backend

    try:
        backend = select_backend(choice)
    except UserError as error:
        report.problem = str(error)
        return report
    import drjit as dr
    import mitsuba as mi

    facts["backend"] = backend.variant
    facts["why"] = backend.reason
    facts["threads"] = dr.thread_count()
    if backend.llvm is not None:
        facts["llvm"] = f"{'.'.join(map(str, dr.detail.llvm_version()))} ({backend.llvm.path})"
    facts["kernel"] = "runs" if float(dr.sum(dr.arange(mi.Float, 4) + 1)[0]) == 10 else "wrong result"
    return report
