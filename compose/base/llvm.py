"""Finds a shared LLVM that Dr.Jit can use, and points Dr.Jit to it.

This happens when one of the packages is imported: `import drjit` loads the first LLVM that it finds, and a
wrong one aborts the process at the first kernel.
"""

from __future__ import annotations

import ctypes.util
import os
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from compose.base.errors import UserError

_PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"
# Dr.Jit 1.5 refuses LLVM 14, and LLVM 15 and 16 abort the process on AVX-512 machines
# ("Cannot select: fminimum"). 19.1 and 23.1 are known to work.
MINIMUM_LLVM = 19
LLVM_HINT = "install one with: pip install karellen-llvm-core   (or: apt install libllvm19)"

_LIBRARY_NAME = re.compile(r"libLLVM(?:-(\d+))?(?:\.so(?:\.(\d+))?.*)$")


@dataclass(frozen=True)
class Llvm:
    """A shared LLVM library: where it is, and its major version (None where the name does not tell)."""

    path: Path
    version: int | None


def llvm_version(path: Path) -> int | None:
    """Major version from the library's name or, for a bare libLLVM.so, from what it links to."""
    for candidate in (path, path.resolve()):
        match = _LIBRARY_NAME.match(candidate.name)
        if match and (match.group(1) or match.group(2)):
            return int(match.group(1) or match.group(2))
    return None


def _system_libraries() -> Iterable[Path]:
    for folder in ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"):
        yield from Path(folder).glob("libLLVM*.so*")
    yield from Path("/usr/lib").glob("llvm-*/lib/libLLVM*.so*")
    found = ctypes.util.find_library("LLVM")
    if found and os.path.isabs(found):
        yield Path(found)


def _environment_libraries() -> Iterable[Path]:
    yield from (Path(sys.prefix) / "lib").glob("libLLVM*.so*")


def find_llvm() -> Llvm:
    """The LLVM to use: DRJIT_LIBLLVM_PATH, else the newest good system one, else the pip package's.

    Raises:
        UserError: there is none, or only versions that Dr.Jit cannot use.
    """
    explicit = os.environ.get(_PATH_VARIABLE)
    if explicit:
        llvm = Llvm(Path(explicit), llvm_version(Path(explicit)))
        if not llvm.path.exists():
            raise UserError(f"{_PATH_VARIABLE}={explicit} does not exist; {LLVM_HINT}")
        if llvm.version is not None and llvm.version < MINIMUM_LLVM:
            raise UserError(
                f"{_PATH_VARIABLE}={explicit} is LLVM {llvm.version}, which Dr.Jit cannot use "
                f"({MINIMUM_LLVM} or newer); {LLVM_HINT}"
            )
        return llvm
    too_old: set[int] = set()
    for libraries in (_system_libraries(), _environment_libraries()):
        known = [Llvm(path, llvm_version(path)) for path in sorted(libraries)]
        good = [llvm for llvm in known if llvm.version is not None and llvm.version >= MINIMUM_LLVM]
        if good:
            return max(good, key=lambda llvm: llvm.version or 0)
        too_old |= {llvm.version for llvm in known if llvm.version is not None}
    seen = f"only LLVM {', '.join(map(str, sorted(too_old)))} found" if too_old else "no LLVM found"
    raise UserError(f"{seen}, Dr.Jit needs {MINIMUM_LLVM} or newer; {LLVM_HINT}")


def point_drjit_to_llvm() -> Llvm | UserError:
    """Sets DRJIT_LIBLLVM_PATH to a good LLVM or, where there is none, to nothing at all.

    Returns:
        The LLVM, or what is wrong.
    """
    try:
        llvm = find_llvm()
    except UserError as problem:
        os.environ[_PATH_VARIABLE] = os.devnull
        return problem
    os.environ[_PATH_VARIABLE] = str(llvm.path)
    return llvm
