"""`import splat`: its public names, at no cost until they are used."""

from __future__ import annotations

import doctest
import subprocess
import sys

import pytest

import splat


def test_importing_loads_neither_torch_nor_drjit():
    code = "import sys, splat; print([name for name in ('torch', 'drjit', 'numpy') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there():
    names = (
        "Camera Forest Gaussians Place load_forest load_ply look_at rasterization render save_forest save_ply"
    )
    assert splat.__all__ == names.split()
    for name in splat.__all__:
        assert getattr(splat, name).__name__ == name
    assert set(splat.__all__) <= set(dir(splat))


def test_other_names_are_refused():
    with pytest.raises(AttributeError, match="module 'splat' has no attribute 'rasterise'"):
        splat.rasterise  # noqa: B018


@pytest.mark.parametrize("name", ["rasterization", "render"])
def test_examples_run(name):
    """The snippets in docstrings, line by line."""
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(splat, name), name, globs={})
    assert len(example.examples) > 5
    assert doctest.DocTestRunner().run(example).failed == 0


def test_types_are_announced():
    from pathlib import Path

    assert (Path(splat.__file__).parent / "py.typed").is_file()
