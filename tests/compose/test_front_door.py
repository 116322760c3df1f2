"""Importing compose points Dr.Jit to LLVM before anything loads Dr.Jit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

PROGRAM = """
import os, sys
import compose
print("drjit" in sys.modules)
print(os.environ["DRJIT_LIBLLVM_PATH"])
print(type(compose.LLVM).__name__)
if isinstance(compose.LLVM, Exception):
    import drjit
    drjit.has_backend(drjit.JitBackend.LLVM)
"""


def imported(path: Path) -> list[str]:
    """What a new process reports that has DRJIT_LIBLLVM_PATH set to a path."""
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": str(path)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout.split()


def test_a_usable_llvm_is_passed_to_drjit(tmp_path):
    library = tmp_path / "libLLVM.so.19.1"
    library.touch()
    assert imported(library) == ["False", str(library), "Llvm"]


def test_without_a_usable_llvm_drjit_finds_none(tmp_path):
    """Dr.Jit is loaded at once, since its complaint cannot be caught where others load it."""
    assert imported(tmp_path / "libLLVM.so.19.1") == ["True", os.devnull, "UserError"]
