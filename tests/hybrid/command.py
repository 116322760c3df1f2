"""Commands as a user gives them, in this process."""

from __future__ import annotations

import sys

from hybrid.cli.main import main

TINY_CAPTURE = ["--views", "5", "--held-out", "3", "--size", "32", "32", "--spp", "2", "--held-out-spp", "4"]
TINY_TRAINING = ["--iterations", "40", "--gaussians", "400", "--degree", "1", "--layers", "2"]


def run(monkeypatch, *arguments: object) -> int:
    """Runs a command and returns its exit code."""
    monkeypatch.setattr(sys, "argv", ["hybrid", *map(str, arguments)])
    try:
        main()
    except SystemExit as stopped:
        return int(stopped.code or 0)
    return 0
