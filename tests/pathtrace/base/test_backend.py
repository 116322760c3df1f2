"""Which LLVM is taken, and what is said where there is none."""

from __future__ import annotations

from pathlib import Path

import pytest

import compose.base.llvm as module
from compose.base.errors import UserError
from compose.base.llvm import find_llvm, llvm_version
from pathtrace.base.backend import select_backend


def libraries(monkeypatch, tmp_path: Path, system: list[str], environment: list[str]) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    for kind, names in (("_system_libraries", system), ("_environment_libraries", environment)):
        paths = [tmp_path / kind / name for name in names]
        for path in paths:
            path.parent.mkdir(exist_ok=True)
            path.touch()
        monkeypatch.setattr(module, kind, lambda paths=paths: paths)


@pytest.mark.parametrize(
    ("name", "version"),
    [("libLLVM-15.so.1", 15), ("libLLVM.so.19.1", 19), ("libLLVM-23.so", 23), ("libLLVM.so", None)],
)
def test_the_version_is_in_the_name(name, version):
    assert llvm_version(Path("/nowhere") / name) == version


def test_a_good_system_library_comes_first(monkeypatch, tmp_path):
    libraries(monkeypatch, tmp_path, ["libLLVM-15.so.1", "libLLVM.so.19.1"], ["libLLVM-23.so"])
    assert find_llvm().version == 19


def test_versions_that_abort_are_passed_over(monkeypatch, tmp_path):
    libraries(monkeypatch, tmp_path, ["libLLVM-15.so.1", "libLLVM-16.so"], ["libLLVM-23.so"])
    assert find_llvm().version == 23


@pytest.mark.parametrize(("names", "seen"), [(["libLLVM-15.so.1"], "only LLVM 15"), ([], "no LLVM found")])
def test_no_usable_library_says_what_to_install(monkeypatch, tmp_path, names, seen):
    libraries(monkeypatch, tmp_path, names, [])
    with pytest.raises(UserError, match=rf"{seen}.*pip install karellen-llvm-core"):
        find_llvm()


def test_an_explicit_path_must_be_good(monkeypatch, tmp_path):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-19.so"))
    with pytest.raises(UserError, match="does not exist"):
        find_llvm()
    (tmp_path / "libLLVM-15.so").touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-15.so"))
    with pytest.raises(UserError, match="is LLVM 15"):
        find_llvm()


def test_the_choice_of_backend_is_checked(backend):
    with pytest.raises(UserError, match="must be auto, cuda or llvm"):
        select_backend("metal")
    other = "cuda" if backend.variant.startswith("llvm") else "llvm"
    with pytest.raises(UserError, match="already in use"):
        select_backend(other)
