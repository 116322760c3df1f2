"""Commands that are killed at random moments resume, and end with what they would have made in peace."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.extremes import extreme

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


def killing(folder: Path, kills: int, seed: int, *jobs: str) -> dict[str, dict]:
    """What happened to each command, by name."""
    arguments = [str(folder), str(kills), str(seed), *jobs]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-m", "tests.faults.killing", *arguments],
        env=environment,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, dict] = {}
    for line in done.stdout.splitlines():
        found |= json.loads(line)
    return found


@extreme(
    "4 kills of a capture",
    given="SIGKILL, two at random moments, two between the steps of a write",
    expected="the same bytes as in peace, no unreadable file, nothing left behind",
)
def test_a_killed_capture_resumes(tmp_path, got):
    (found,) = killing(tmp_path, 4, 1, "traced").values()
    assert not found["failures"]
    assert found["kills"] == 4
    got(f"{found['kills']} kills, {found['completed']} captures of the same bytes")


@pytest.mark.long
@extreme(
    "4 kills of a capture in parts",
    given="SIGKILL, two each of a part and of its merge, at random moments and between the steps of a write",
    expected="the same bytes as in peace, no unreadable file, nothing left behind",
)
def test_a_killed_part_resumes_and_so_does_its_merge(tmp_path, got):
    found = killing(tmp_path, 2, 1, "part", "merge")
    assert not [failure for one in found.values() for failure in one["failures"]]
    assert sum(one["kills"] for one in found.values()) == 4
    got(f"4 kills, {sum(one['completed'] for one in found.values())} ends with the same bytes")


@pytest.mark.long
@extreme(
    "100 kills",
    given="SIGKILL of capture, training, evaluation and sweep, 25 times each",
    expected="the same bytes or figures as in peace, no unreadable file, nothing left behind",
)
def test_commands_survive_100_kills(tmp_path, got):
    found = killing(tmp_path, 25, 7, "capture", "train", "evaluate", "sweep")
    assert not [failure for one in found.values() for failure in one["failures"]]
    assert sum(one["kills"] for one in found.values()) == 100
    got(", ".join(f"{name} {one['kills']} in {one['runs']} runs" for name, one in found.items()))
