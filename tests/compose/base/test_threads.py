"""How long torch's threads wait awake: set before torch is loaded, and never against the user's word."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from compose.base.startup import let_waiting_threads_sleep

ROOT = Path(__file__).resolve().parents[3]
_VARIABLES = ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")
CASES = pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, "1000"),
        ({"GOMP_SPINCOUNT": "7"}, "7"),
        ({"OMP_WAIT_POLICY": "active"}, "None"),
        ({"GOMP_SPINCOUNT": "7", "OMP_WAIT_POLICY": "passive"}, "7"),
    ],
)


def output(script: str, **environment: str) -> str:
    """What a script prints in a process with these variables and no others of OpenMP."""
    rest = {name: value for name, value in os.environ.items() if name not in _VARIABLES}
    command = [sys.executable, "-c", script]
    done = subprocess.run(
        command, cwd=ROOT, env=rest | environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@CASES
def test_one_setting_is_made_unless_the_user_made_it(environment, expected, monkeypatch):
    for name in _VARIABLES:
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    let_waiting_threads_sleep()
    after = dict(os.environ)
    assert str(after.pop("GOMP_SPINCOUNT", None)) == expected
    before.pop("GOMP_SPINCOUNT", None)
    assert after == before


@CASES
def test_the_users_own_setting_wins(environment, expected):
    assert output("import compose, os; print(os.environ.get('GOMP_SPINCOUNT'))", **environment) == expected


@pytest.mark.parametrize(
    "module", ["hybrid.render.frame_renderer", "splat.raster.differentiable", "compose.fusion.combination"]
)
def test_it_is_set_before_torch_is_loaded(module):
    """Whichever package is imported first."""
    script = f"""
import os, sys

class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "torch":
            print(os.environ.get("GOMP_SPINCOUNT"), flush=True)
            os._exit(0)

sys.meta_path.insert(0, Watch())
import {module}
"""
    assert output(script) == "1000"
