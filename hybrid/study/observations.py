"""What observers answered: votes on a scale, or choices between two, and the CSV files that hold them."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below, write_whole

RATING_COLUMNS: tuple[str, ...] = ("observer", "scene", "condition", "vote")
CHOICE_COLUMNS: tuple[str, ...] = ("observer", "scene", "first", "second", "chosen")
# May be missing from a file.
_OPTIONAL = ("scene",)
# Rows of any other kind, such as training, are not votes.
_KIND, _VOTE = "kind", "vote"
# Far more than any study has.
_MOST_BYTES = 1 << 26
_LONGEST_NAME = 200

Names = NDArray[np.str_]


@dataclass(frozen=True)
class Ratings:
    """Votes on a scale, (N,) each; `left_out`: rows of the file that were not votes, or unanswered."""

    observer: Names
    scene: Names
    condition: Names
    vote: NDArray[np.float64]
    left_out: int = 0

    @property
    def conditions(self) -> set[str]:
        """All that were voted on."""
        return set(self.condition.tolist())


@dataclass(frozen=True)
class Choices:
    """Choices between two conditions of a group, (N,) each; conditions of two groups are never compared."""

    observer: Names
    group: Names
    first: Names
    second: Names
    chosen_first: NDArray[np.bool_]
    left_out: int = 0

    @property
    def conditions(self) -> set[str]:
        """All that were chosen from."""
        return {*self.first.tolist(), *self.second.tolist()}


_Observations = TypeVar("_Observations", bound=Ratings | Choices)


@dataclass
class _Table:
    """Cells of the wanted columns, by their canonical names, and what was left out."""

    cells: dict[str, list[str]]
    places: list[str] = field(default_factory=list)
    left_out: int = 0


def load_ratings(
    path: Path, columns: Mapping[str, str] | None = None, scale: tuple[float, float] = (1.0, 5.0)
) -> Ratings:
    """Votes from a CSV file, or from all CSV files of a folder, with observer, scene, condition and vote.

    `columns` says which columns of the file are meant by these names, as {"scene": "clip+luminance"}: names
    of several are joined by " / ". A file need not have scenes. Rows with an empty vote, and rows whose
    column `kind`, if there is one, is not `vote`, are left out and counted.

    UserError, of one line, for a file that cannot be read, lacks a column, or holds a name that is empty, not
    printable or longer than 200 characters, a vote outside the `scale`, or no votes at all.
    """
    table = _load(path, RATING_COLUMNS, "vote", columns)
    votes = [_vote(*cell, scale) for cell in zip(table.cells["vote"], table.places, strict=True)]
    names = {name: np.array(table.cells[name], str) for name in RATING_COLUMNS[:-1]}
    return Ratings(**names, vote=np.array(votes), left_out=table.left_out)


def load_choices(path: Path, columns: Mapping[str, str] | None = None) -> Choices:
    """Choices from a CSV file, or from all CSV files of a folder: observer, scene, first, second and chosen.

    `chosen` is 1 or 2, or the very name of the first or the second condition; `scene` becomes the group.
    `columns`, what is left out, and errors are as for `load_ratings`; a condition cannot be compared with
    itself.
    """
    table = _load(path, CHOICE_COLUMNS, "chosen", columns)
    rows = zip(*(table.cells[name] for name in ("first", "second", "chosen")), table.places, strict=True)
    chosen_first = np.array([_is_first(*row) for row in rows])
    observer, group, first, second = (np.array(table.cells[name], str) for name in CHOICE_COLUMNS[:-1])
    return Choices(observer, group, first, second, chosen_first, table.left_out)


def save(path: Path, observations: Ratings | Choices) -> None:
    """Writes a CSV file that `load_ratings` or `load_choices` reads; it appears whole or not at all."""
    if isinstance(observations, Ratings):
        head, answers = RATING_COLUMNS, np.array([f"{vote:.17g}" for vote in observations.vote])
        names = [observations.observer, observations.scene, observations.condition]
    else:
        head, answers = CHOICE_COLUMNS, np.where(observations.chosen_first, "1", "2")
        names = [observations.observer, observations.group, observations.first, observations.second]
    write_table(path, [head, *zip(*names, answers, strict=True)])


def without(observations: _Observations, dropped: Sequence[str]) -> _Observations:
    """The answers of all other observers."""
    kept = ~np.isin(observations.observer, dropped)
    parts = {name: part[kept] for name, part in vars(observations).items() if name != "left_out"}
    return replace(observations, **parts)


def write_table(path: Path, rows: Sequence[Sequence[object]]) -> None:
    """Writes rows as a CSV file, whole or not at all."""

    def write(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(rows)

    write_whole(path, write)


def required(module: str, what: str) -> Any:
    """A module of the optional extra `study`; UserError if it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise UserError(
            f"{what} requires {package}, which is not installed: install foveated-hybrid-renderer[study]"
        ) from None


def _load(path: Path, wanted: Sequence[str], answer: str, columns: Mapping[str, str] | None) -> _Table:
    """Cells of all answered rows of a file or of a folder's files."""
    unknown = sorted(set(columns or {}) - set(wanted))
    if unknown:
        raise UserError(f"column {unknown[0]!r}: is unknown; must be one of {', '.join(wanted)}")
    table = _Table({name: [] for name in wanted})
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    if not files:
        raise UserError(f"{path}: holds no CSV files")
    for file in files:
        try:
            require_size_below(file, _MOST_BYTES)
            # Spreadsheets start texts with a byte order mark.
            with file.open(newline="", encoding="utf-8-sig") as opened:
                _add_rows(table, file, csv.reader(opened), answer, columns or {})
        except (OSError, ValueError, csv.Error) as error:
            raise UserError(f"{file}: cannot be read ({one_line(error)})") from error
    if not table.places:
        raise UserError(f"{path}: holds no answers")
    return table


def _add_rows(
    table: _Table, file: Path, rows: Iterator[list[str]], answer: str, columns: Mapping[str, str]
) -> None:
    """Adds the rows of one file."""
    head = [name.strip() for name in next(rows, [])]
    sources = {name: _sources(file, head, name, columns.get(name, name)) for name in table.cells}
    kind = head.index(_KIND) if _KIND in head else None
    # An answer may span lines of the file.
    for number, row in enumerate(rows, 2):
        if not any(cell.strip() for cell in row):
            continue
        place = f"{file}: row {number}"
        if len(row) != len(head):
            raise UserError(f"{place} has {len(row)} cells; must have {len(head)}, as the first row")
        found = {name: " / ".join(row[at].strip() for at in at_all) for name, at_all in sources.items()}
        if not found[answer] or (kind is not None and row[kind].strip() != _VOTE):
            table.left_out += 1
            continue
        for name, cell in found.items():
            _check_name(place, name, cell)
            table.cells[name].append(cell)
        table.places.append(place)


def _sources(file: Path, head: list[str], name: str, source: str) -> list[int]:
    """Indices of the columns that a name stands for; none for a scene that the file does not have."""
    parts = [source] if source in head else [part.strip() for part in source.split("+")]
    lacks = [part for part in parts if part not in head]
    if lacks and name in _OPTIONAL and source == name:
        return []
    if lacks:
        shown = one_line(", ".join(head))[:120]
        raise UserError(f"{file}: has no column {lacks[0]!r} for {name!r}; its first row is: {shown}")
    twice = [part for part in parts if head.count(part) > 1]
    if twice:
        raise UserError(f"{file}: has {head.count(twice[0])} columns {twice[0]!r}; must have one")
    return [head.index(part) for part in parts]


def _check_name(place: str, name: str, cell: str) -> None:
    if not cell.strip(" /") and name not in _OPTIONAL:
        raise UserError(f"{place}: {name} is empty")
    if len(cell) > _LONGEST_NAME or not cell.isprintable():
        shown = one_line(cell)[:40]
        raise UserError(f"{place}: {name} {shown!r} must be printable, of at most {_LONGEST_NAME} characters")


def _vote(cell: str, place: str, scale: tuple[float, float]) -> float:
    try:
        vote = float(cell)
    except ValueError:
        vote = math.nan
    # Not a number is not within the scale either.
    if not scale[0] <= vote <= scale[1]:
        raise UserError(f"{place}: vote {cell[:40]!r} must be a number from {scale[0]:g} to {scale[1]:g}")
    return vote


def _is_first(first: str, second: str, chosen: str, place: str) -> bool:
    if first == second:
        raise UserError(f"{place}: compares {first!r} with itself")
    # Names come before numbers: a condition may be called "2".
    answers = {"1": True, "2": False, first: True, second: False}
    if chosen not in answers:
        raise UserError(f"{place}: chosen {chosen[:40]!r} must be 1, 2, {first!r} or {second!r}")
    return answers[chosen]
