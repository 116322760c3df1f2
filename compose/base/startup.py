"""Settles, when `compose` is imported, which LLVM Dr.Jit uses and that waiting threads sleep.

`import drjit` loads the first LLVM it finds, and a wrong one aborts the process at the first kernel. OpenMP
reads its settings once, when torch loads it: threads that wait must not take the processor from those that
work.
"""

from __future__ import annotations

import ctypes.util
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from compose.base.errors import UserError

_PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"
# Dr.Jit 1.5 refuses LLVM 14, and LLVM 15 and 16 abort the process on AVX-512 machines
# ("Cannot select: fminimum"). LLVM 19.1 and 23.1 are known to work.
MINIMUM_LLVM = 19
_HINT = "install one with: pip install karellen-llvm-core   (or: apt install libllvm19)"
_LIBRARY_NAME = re.compile(r"libLLVM(?:-(\d+))?(?:\.so(?:\.(\d+))?.*)$")
# Turns of a loop in which torch's threads wait for work before they sleep. By GNU OpenMP's default they do so
# for milliseconds, which delays whoever has work where other processes are busy.
_SPINS = 1000


class Llvm(NamedTuple):
    """A shared LLVM library and its major version, None if the name does not contain it."""

    path: Path
    version: int | None


def llvm_version(path: Path) -> int | None:
    """Major version from the library's name or, for a bare libLLVM.so, from the name that it links to."""
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


def find_llvm() -> Llvm:
    """The LLVM to use: DRJIT_LIBLLVM_PATH, else the newest usable one of the system, else the pip package's.

    UserError if there is none, or only versions that Dr.Jit cannot use.
    """
    if explicit := os.environ.get(_PATH_VARIABLE):
        path, version = Path(explicit), llvm_version(Path(explicit))
        if not path.exists():
            raise UserError(f"{_PATH_VARIABLE}={explicit} does not exist; {_HINT}")
        if version is not None and version < MINIMUM_LLVM:
            refused = f"is LLVM {version}, which Dr.Jit cannot use ({MINIMUM_LLVM} or newer)"
            raise UserError(f"{_PATH_VARIABLE}={explicit} {refused}; {_HINT}")
        return Llvm(path, version)
    too_old: set[int] = set()
    for libraries in (_system_libraries(), (Path(sys.prefix) / "lib").glob("libLLVM*.so*")):
        known = [Llvm(path, llvm_version(path)) for path in sorted(libraries)]
        good = [llvm for llvm in known if llvm.version is not None and llvm.version >= MINIMUM_LLVM]
        if good:
            return max(good, key=lambda llvm: llvm.version or 0)
        too_old |= {llvm.version for llvm in known if llvm.version is not None}
    seen = f"only LLVM {', '.join(map(str, sorted(too_old)))} found" if too_old else "no LLVM found"
    raise UserError(f"{seen}, Dr.Jit needs {MINIMUM_LLVM} or newer; {_HINT}")


def point_drjit_to_llvm() -> Llvm | UserError:
    """Sets DRJIT_LIBLLVM_PATH to a usable LLVM, or to the null device; returns that, or why there is none."""
    try:
        llvm = find_llvm()
    except UserError as problem:
        os.environ[_PATH_VARIABLE] = os.devnull
        _import_drjit_silently()
        return problem
    os.environ[_PATH_VARIABLE] = str(llvm.path)
    return llvm


def _import_drjit_silently() -> None:
    """Loads Dr.Jit, which reports the missing LLVM on the process's standard error, not on Python's."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        import drjit

        drjit.has_backend(drjit.JitBackend.LLVM)
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def let_waiting_threads_sleep() -> None:
    """Sets GOMP_SPINCOUNT, unless the user has set it or OMP_WAIT_POLICY, which it would overrule."""
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", str(_SPINS))


def names_on_demand(
    package: str, modules: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a package, by its `__name__`, that imports names on first use.

    Of each name, `modules` says where it is defined.
    """
    own = vars(sys.modules[package])

    def found(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        own[name] = getattr(import_module(modules[name]), name)
        return own[name]

    return found, lambda: sorted({*own, *modules})
