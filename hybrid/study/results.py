"""What observers of a study answered, or of one that was run elsewhere, ready for its analysis."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from compose.base.errors import UserError, reading
from hybrid.study.design import FILE, StudyMethod, load_design
from hybrid.study.observations import Choices, Ratings, load_choices, load_ratings, without
from hybrid.study.session import RESULTS

# Share of the trials that check attention which an observer must answer as an attentive one would.
_LEAST_RIGHT = 0.5
# What tells choices from votes in the first row of a file, unless columns are named.
_OF_CHOICES = "chosen"


def answers(
    source: Path, columns: Mapping[str, str], scale: tuple[float, float], keep_all: bool
) -> tuple[Ratings | Choices, list[str]]:
    """Votes or choices of a study's folder or of a CSV file, and the observers who failed to attend.

    These are left out, unless all are kept. For `columns` and errors see `load_ratings` and `load_choices`.
    """
    if not (source / FILE).is_file():
        if source.is_dir():
            raise UserError(f"{source}: holds no study and is no CSV file")
        found = _is_of_choices(source, columns)
        return (load_choices(source, columns) if found else load_ratings(source, columns, scale)), []
    design, folder = load_design(source), source / RESULTS
    if columns:
        raise UserError(f"{source}: is a study; columns are named for CSV files only")
    if not any(folder.glob("*.csv")):
        raise UserError(f"{source}: nobody has answered yet; use hybrid study run")
    loaded = load_choices(folder) if design.method is StudyMethod.PAIRS else load_ratings(folder)
    failed = [] if keep_all else _inattentive(folder)
    kept = without(loaded, failed)
    if not len(kept.observer):
        raise UserError(f"{source}: every observer failed to attend")
    return kept, failed


def _is_of_choices(file: Path, columns: Mapping[str, str]) -> bool:
    if columns:
        return not {"first", "second", _OF_CHOICES}.isdisjoint(columns)
    with reading(file), file.open(newline="", encoding="utf-8-sig") as opened:
        return _OF_CHOICES in [name.strip() for name in next(csv.reader(opened), [])]


def _inattentive(folder: Path) -> list[str]:
    """Observers who gave too few of the answers that are known."""
    right: dict[str, list[bool]] = {}
    for file in sorted(folder.glob("*.csv")):
        with reading(file), file.open(newline="", encoding="utf-8") as opened:
            for row in csv.DictReader(opened):
                if row.get("kind") == "attention":
                    right.setdefault(row["observer"], []).append(row.get("correct") == "yes")
    return [name for name, found in right.items() if np.mean(found) < _LEAST_RIGHT]
