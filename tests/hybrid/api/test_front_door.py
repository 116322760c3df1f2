"""`import hybrid`: quick, with names that all resolve, and with documented snippets that run."""

from __future__ import annotations

import doctest
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import hybrid
from hybrid.render.image_files import read_exr

ROOT = Path(__file__).resolve().parents[3]


def test_importing_hybrid_loads_no_renderer():
    program = (
        "import sys, hybrid; "
        "print([name for name in ('torch', 'mitsuba', 'drjit', 'numpy', 'rich') if name in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


def test_settings_load_no_renderer_either():
    program = (
        "import sys, hybrid; hybrid.FrameSettings(); hybrid.CaptureSettings(); hybrid.UserError; "
        "print([name for name in ('torch', 'mitsuba', 'drjit') if name in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("name", hybrid.__all__)
def test_every_public_name_resolves_to_what_its_module_has(name, backend):
    value = getattr(hybrid, name)
    assert value is getattr(import_module(value.__module__), name)
    assert value.__name__ == name
    assert value.__doc__


def test_public_names_are_listed():
    assert hybrid.__all__ == sorted(hybrid.__all__)
    assert {*hybrid.__all__} <= {*dir(hybrid)}
    assert {"Renderer", "FrameSettings", "load_scene", "load_forest", "capture", "train", "evaluate"} <= {
        *hybrid.__all__
    }
    assert dir(hybrid) == sorted(set(dir(hybrid)))


def test_public_names_are_those_that_type_checkers_see():
    source = (ROOT / "hybrid" / "__init__.py").read_text()
    declared = re.findall(r"^    from ([\w.]+) import (\w+) as \2$", source, flags=re.MULTILINE)
    assert {name for _, name in declared} == {*hybrid.__all__}
    for module, name in declared:
        assert getattr(import_module(module), name) is getattr(hybrid, name)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'hybrid' has no attribute 'draw'"):
        _ = hybrid.draw


@pytest.fixture
def in_folder(made, monkeypatch, tmp_path):
    """The current folder, with a forest of the Cornell box under the name that the snippets use."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(made / "box.forest", tmp_path / "cornell.forest")
    return tmp_path


def check_written(folder: Path) -> None:
    channels = read_exr(folder / "frame.exr")
    assert np.isfinite(channels["composite.R"]).all()
    assert channels["composite.R"].mean() > 0.01


def test_the_example_of_the_package_runs(in_folder):
    examples = doctest.DocTestParser().get_examples(hybrid.__doc__)
    assert len(examples) > 3
    exec("".join(example.source for example in examples).replace("room", "cornell"), {})
    check_written(in_folder)


def test_the_example_of_the_readme_runs(in_folder):
    text = (ROOT / "README.md").read_text()
    snippet = re.search(r"<!-- python -->\n```python\n(.*?)```", text, flags=re.DOTALL).group(1)
    assert "import hybrid" in snippet
    exec(snippet.replace("room", "cornell"), {})
    check_written(in_folder)
