"""What observers answered: votes on a scale, or choices between two, and the CSV files that hold them."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, one_line, reading
from compose.base.files import require_size_below, write_whole
from hybrid.study.design import FILE, StudyMethod, load_design
from hybrid.study.session import RESULTS

RATING_COLUMNS: tuple[str, ...] = ("observer", "scene", "condition", "vote")
CHOICE_COLUMNS: tuple[str, ...] = ("observer", "scene", "first", "second", "chosen")
# May be missing from a file.
_OPTIONAL = ("scene",)
# Rows of any other kind, such as training, are not votes.
_KIND, _VOTE = "kind", "vote"
# What tells choices from votes in the first row of a file, unless columns are named.
_CHOSEN = "chosen"
# Share of the trials that check attention which an observer must answer as an attentive one would.
_LEAST_RIGHT = 0.5
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


@dataclass(frozen=True)
class Choices:
    """Choices between two conditions of a group, (N,) each; conditions of two groups are never compared."""

    observer: Names
    group: Names
    first: Names
    second: Names
    chosen_first: NDArray[np.bool_]
    left_out: int = 0


_Observations = TypeVar("_Observations", bound=Ratings | Choices)
# Where a row stands, for people, and its cells in the wanted columns.
_Row: TypeAlias = tuple[str, dict[str, str]]


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
    rows, left_out = _load(path, RATING_COLUMNS, columns)
    votes = [_vote(cells["vote"], place, scale) for place, cells in rows]
    observer, scene, condition = _names(rows, RATING_COLUMNS[:-1])
    return Ratings(observer, scene, condition, np.array(votes), left_out)


def load_choices(path: Path, columns: Mapping[str, str] | None = None) -> Choices:
    """Choices from a CSV file, or from all CSV files of a folder: observer, scene, first, second and chosen.

    `chosen` is 1 or 2, or the very name of the first or the second condition; `scene` becomes the group.
    `columns`, what is left out, and errors are as for `load_ratings`; a condition cannot be compared with
    itself.
    """
    rows, left_out = _load(path, CHOICE_COLUMNS, columns)
    chosen = [_is_first(cells["first"], cells["second"], cells["chosen"], place) for place, cells in rows]
    observer, group, first, second = _names(rows, CHOICE_COLUMNS[:-1])
    return Choices(observer, group, first, second, np.array(chosen), left_out)


def save(path: Path, observations: Ratings | Choices) -> None:
    """Writes a CSV file that `load_ratings` or `load_choices` reads; it appears whole or not at all."""
    *names, answers, _ = vars(observations).values()
    if isinstance(observations, Ratings):
        head, texts = RATING_COLUMNS, [f"{vote:.17g}" for vote in answers]
    else:
        head, texts = CHOICE_COLUMNS, ["1" if first else "2" for first in answers]
    write_table(path, [head, *zip(*names, texts, strict=True)])


def answers(
    source: Path, columns: Mapping[str, str], scale: tuple[float, float], keep_all: bool
) -> tuple[Ratings | Choices, list[str]]:
    """Votes or choices of a study's folder or of a CSV file, and the observers who failed to attend.

    These are left out, unless all are kept. For `columns` and errors see `load_ratings` and `load_choices`.
    """
    if not (source / FILE).is_file():
        if source.is_dir():
            raise UserError(f"{source}: holds no study and is no CSV file")
        if columns:
            of_choices = not {"first", "second", _CHOSEN}.isdisjoint(columns)
        else:
            with reading(source), source.open(newline="", encoding="utf-8-sig") as opened:
                of_choices = _CHOSEN in [name.strip() for name in next(csv.reader(opened), [])]
        return load_choices(source, columns) if of_choices else load_ratings(source, columns, scale), []
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


def _inattentive(folder: Path) -> list[str]:
    """Observers who gave too few of the answers that are known."""
    right: dict[str, list[bool]] = {}
    for file in sorted(folder.glob("*.csv")):
        with reading(file), file.open(newline="", encoding="utf-8") as opened:
            for row in csv.DictReader(opened):
                if row.get("kind") == "attention":
                    right.setdefault(row["observer"], []).append(row.get("correct") == "yes")
    return [name for name, found in right.items() if np.mean(found) < _LEAST_RIGHT]


def conditions_of(observations: Ratings | Choices) -> set[str]:
    """All that were voted on, or chosen from."""
    if isinstance(observations, Ratings):
        return set(observations.condition.tolist())
    return {*observations.first.tolist(), *observations.second.tolist()}


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


def required(module: str, what: str) -> ModuleType:
    """A module of the optional extra `study`; UserError if it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise UserError(
            f"{what} requires {package}, which is not installed: install foveated-hybrid-renderer[study]"
        ) from None


def _load(path: Path, wanted: Sequence[str], columns: Mapping[str, str] | None) -> tuple[list[_Row], int]:
    """Answered rows of a file or of a folder's files, and the number of all others."""
    columns = columns or {}
    unknown = sorted(set(columns) - set(wanted))
    if unknown:
        raise UserError(f"column {unknown[0]!r}: is unknown; must be one of {', '.join(wanted)}")
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    if not files:
        raise UserError(f"{path}: holds no CSV files")
    rows: list[_Row | None] = []
    for file in files:
        try:
            require_size_below(file, _MOST_BYTES)
            # Spreadsheets start texts with a byte order mark.
            with file.open(newline="", encoding="utf-8-sig") as opened:
                rows += _rows_of(file, csv.reader(opened), {name: columns.get(name, name) for name in wanted})
        except (OSError, ValueError, csv.Error) as error:
            raise UserError(f"{file}: cannot be read ({one_line(error)})") from error
    answered = [row for row in rows if row is not None]
    if not answered:
        raise UserError(f"{path}: holds no answers")
    return answered, len(rows) - len(answered)


def _rows_of(file: Path, rows: Iterator[list[str]], sources: Mapping[str, str]) -> Iterator[_Row | None]:
    """The rows of one file, None for one that is no answer; the last of the wanted columns has the answer."""
    head = [name.strip() for name in next(rows, [])]
    places = {name: _places(file, head, name, source) for name, source in sources.items()}
    kind = head.index(_KIND) if _KIND in head else None
    # An answer may span lines of the file.
    for number, row in enumerate(rows, 2):
        if not any(cell.strip() for cell in row):
            continue
        place = f"{file}: row {number}"
        if len(row) != len(head):
            raise UserError(f"{place} has {len(row)} cells; must have {len(head)}, as the first row")
        cells = {name: " / ".join(row[at].strip() for at in at_all) for name, at_all in places.items()}
        if not [*cells.values()][-1] or (kind is not None and row[kind].strip() != _VOTE):
            yield None
            continue
        for name, cell in cells.items():
            if not cell.strip(" /") and name not in _OPTIONAL:
                raise UserError(f"{place}: {name} is empty")
            if len(cell) > _LONGEST_NAME or not cell.isprintable():
                said = f"{name} {one_line(cell)[:40]!r}"
                raise UserError(f"{place}: {said} must be printable, of at most {_LONGEST_NAME} characters")
        yield place, cells


def _places(file: Path, head: list[str], name: str, source: str) -> list[int]:
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


def _names(rows: Sequence[_Row], columns: Sequence[str]) -> list[Names]:
    return [np.array([cells[name] for _, cells in rows], str) for name in columns]


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
