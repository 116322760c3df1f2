"""Measures every figure that the documentation states, and writes its tables."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.files import json_text


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """The command line of a script that measures, with its docstring as help and --json."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    return parser


def report(found: Mapping[str, Any], file: Path | None) -> None:
    """Prints what was found, and writes it if --json asks for it."""
    text = json_text(found)
    print(text)
    if file:
        file.write_text(text)


def csv_rows(file: Path) -> list[dict[str, str]]:
    """The rows of a CSV file, by the names of its columns."""
    with file.open(newline="") as opened:
        return list(csv.DictReader(opened))


def column(rows: list[dict[str, str]], name: str) -> NDArray[np.float64]:
    """The numbers in a column of a table."""
    return np.array([float(row[name]) for row in rows])


def measure_forest(description: str | None, measured: Callable[[str, Path], dict[str, Any]]) -> None:
    """The command line of a script that measures SCENE with --forest."""
    from pathtrace.scene.backend import select_backend

    parser = parser_of(description)
    parser.add_argument("scene")
    parser.add_argument("--forest", type=Path, required=True)
    options = parser.parse_args()
    select_backend()
    report(measured(options.scene, options.forest), options.json)
