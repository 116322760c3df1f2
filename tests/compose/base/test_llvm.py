"""Which LLVM is used, and what is reported where there is none."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from compose.base import startup as llvm
from compose.base.errors import UserError
from compose.base.startup import Llvm, find_llvm, llvm_version, point_drjit_to_llvm


@pytest.fixture
def libraries(monkeypatch, tmp_path):
    """Makes files stand for the libraries of the system and of the Python environment."""

    def make(system: list[str], environment: list[str]) -> None:
        monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
        paths = [tmp_path / "system" / name for name in system]
        for path in (*paths, *(tmp_path / "lib" / name for name in environment)):
            path.parent.mkdir(exist_ok=True)
            path.touch()
        monkeypatch.setattr(llvm, "_system_libraries", lambda: paths)
        monkeypatch.setattr(sys, "prefix", str(tmp_path))

    return make


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-15.so.1", 15),
        ("libLLVM-19.so", 19),
        ("libLLVM.so.19.1", 19),
        ("libLLVM.so.23", 23),
        ("libLLVM.so", None),
        ("libLLVMCore.so.19", None),
    ],
)
def test_the_version_is_part_of_the_name(name, version):
    assert llvm_version(Path("/nowhere") / name) == version


def test_a_bare_name_has_the_version_of_what_it_links_to(tmp_path):
    (tmp_path / "libLLVM.so.20.1").touch()
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.20.1")
    assert llvm_version(tmp_path / "libLLVM.so") == 20


def test_a_usable_system_library_comes_first(libraries):
    libraries(["libLLVM-15.so.1", "libLLVM.so.19.1"], ["libLLVM-23.so"])
    assert find_llvm().version == 19


def test_the_newest_usable_library_is_chosen(libraries):
    libraries(["libLLVM-19.so", "libLLVM-21.so", "libLLVM-20.so"], [])
    assert find_llvm().version == 21
    assert find_llvm().path.name == "libLLVM-21.so"


def test_versions_that_crash_are_skipped(libraries):
    libraries(["libLLVM-15.so.1", "libLLVM-18.so"], ["libLLVM-23.so"])
    assert find_llvm().version == 23


@pytest.mark.parametrize(
    ("names", "seen"),
    [
        (["libLLVM-15.so.1"], "only LLVM 15"),
        (["libLLVM-18.so", "libLLVM-9.so"], "only LLVM 9, 18"),
        ([], "no LLVM"),
    ],
)
def test_without_a_usable_library_the_error_says_what_to_install(libraries, names, seen):
    libraries(names, [])
    with pytest.raises(UserError, match=rf"{seen} found.* needs 19 or newer.*pip install karellen-llvm-core"):
        find_llvm()


def test_an_explicit_path_must_be_usable(monkeypatch, tmp_path):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-19.so"))
    with pytest.raises(UserError, match="does not exist"):
        find_llvm()
    (tmp_path / "libLLVM-18.so").touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-18.so"))
    with pytest.raises(UserError, match="is LLVM 18"):
        find_llvm()


@pytest.mark.parametrize(("name", "version"), [("libLLVM-19.so", 19), ("custom.so", None)])
def test_an_explicit_path_takes_precedence(libraries, monkeypatch, tmp_path, name, version):
    libraries(["libLLVM-23.so"], [])
    (tmp_path / name).touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / name))
    assert find_llvm() == Llvm(tmp_path / name, version)


def test_the_environment_is_the_one_python_runs_in(monkeypatch, tmp_path):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(llvm, "_system_libraries", lambda: [])
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "libLLVM-23.so").touch()
    assert find_llvm() == Llvm(tmp_path / "lib" / "libLLVM-23.so", 23)


def test_drjit_is_pointed_to_the_library(libraries, monkeypatch):
    libraries(["libLLVM-20.so"], [])
    found = point_drjit_to_llvm()
    assert isinstance(found, Llvm)
    assert os.environ["DRJIT_LIBLLVM_PATH"] == str(found.path)


def test_drjit_is_kept_from_loading_an_unusable_library(libraries, monkeypatch):
    libraries(["libLLVM-15.so"], [])
    assert isinstance(point_drjit_to_llvm(), UserError)
    assert os.environ["DRJIT_LIBLLVM_PATH"] == os.devnull
