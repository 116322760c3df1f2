"""Parts of one job on many machines: what each takes, where it writes, and whether parts fit together."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from compose.base.errors import UserError, one_line
from compose.base.files import json_text, read_json, write_text

# More than any cluster has machines for.
_MOST_PARTS = 10_000
_FILE, _SHARED = "part.json", "shared"
# What may differ among machines that share a job, of what `machine` says.
_OWN = ("cpu", "cores", "gpu")
# In the identity of a part: what the version of the program says, as opposed to what was asked for.
_VERSION = ("code", "machine")


@dataclass(frozen=True)
class Part:
    """One of `count` parts of a job, numbered from 1; UserError if there is no such part."""

    number: int = 1
    count: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count <= _MOST_PARTS:
            raise UserError(
                f"part {self.number}/{self.count}: must be I/N, I from 1 to N and N at most {_MOST_PARTS}"
            )

    def __str__(self) -> str:
        return f"part {self.number} of {self.count}"

    def takes(self, index: int) -> bool:
        """Whether a piece of the job, numbered from 0, is of this part: they are dealt out in turns."""
        return index % self.count == self.number - 1


def part_named(text: str) -> Part:
    """The part that "2/4" means; UserError if it means none."""
    if not re.fullmatch(r"[0-9]{1,9}/[0-9]{1,9}", text):
        raise UserError(f"part {text}: must be I/N, such as 2/4")
    number, count = map(int, text.split("/"))
    return Part(number, count)


@dataclass(frozen=True)
class StoredPart:
    """A part with a folder of its own in the folder that all parts share.

    Attributes:
        folder: its own.
        kind: of the job, the name of its command.
        identity: everything that the results depend on and that must be the same for all parts.
        machine: cpu, cores and gpu that it was done with, which may differ.
        complete: whether all its results are there.
    """

    folder: Path
    kind: str
    part: Part
    identity: dict[str, Any]
    machine: dict[str, Any]
    complete: bool = False

    def finish(self, **used: object) -> None:
        """Notes that all results are there, and what the part used that must be the same for all, too."""
        _write(replace(self, identity={**self.identity, **used}, complete=True))


def begin(shared: Path, kind: str, part: Part, identity: dict[str, Any]) -> StoredPart:
    """Makes the folder of a part, or finds it again.

    The identity is that of `measured_identity`, or has at least its code and machine; values are of types
    that JSON has. UserError, before anything is written, if parts of another job, of another version or with
    other settings are there.
    """
    identity = json.loads(json.dumps(identity))
    own = {name: identity["machine"].pop(name) for name in _OWN}
    name = f"part-{part.number}-of-{part.count}"
    stored = StoredPart(shared / name, kind, part, identity, own)
    with _locked(shared):
        # What the others used beside is compared when they are merged.
        there = stored_parts(shared)
        known = [replace(one, identity={n: one.identity.get(n) for n in identity}) for one in there]
        _require_one_job(shared, [stored, *known])
        _require_same(shared, known, identity, "this one")
        if not (stored.folder / _FILE).is_file():
            _write(stored)
    return stored


@contextmanager
def first_come(shared: Path) -> Iterator[Path]:
    """Keeps the other parts waiting while one makes, or reads, what all of them use.

    Yields the folder for it, beside those of the parts. What is kept there as a file, or in a `Journal` with
    the identity of a `StoredPart`, is made by the part that comes first, and read by the others. Where the
    file system has no locks, several may make it: give what came of it to `finish`, which notices.
    """
    with _locked(shared):
        yield shared / _SHARED


@contextmanager
def _locked(shared: Path) -> Iterator[None]:
    """Keeps parts on all machines out, where the file system can; UserError if it cannot be written."""
    lock = shared / _SHARED / "lock"
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        # NFS locks no folders, and files only if they are open for writing.
        opened = lock.open("a")
    except OSError as error:
        raise UserError(f"{shared}: cannot be written ({one_line(error)})") from error
    with opened:
        with suppress(ImportError, OSError):
            import fcntl

            # A process that dies gives the lock back.
            fcntl.flock(opened, fcntl.LOCK_EX)
        yield


def stored_parts(shared: Path) -> list[StoredPart]:
    """All parts in a folder, whether or not they fit together; UserError if a description is damaged."""
    return [stored_part(path) for path in sorted(shared.glob(f"[!.]*/{_FILE}"))]


def stored_part(path: Path) -> StoredPart:
    """The part that a part.json describes; UserError if it is damaged."""
    try:
        found = read_json(path)
        number, count = found["part"]
        complete, identity = found["complete"], dict(found["identity"])
        if type(complete) is not bool or not all(type(value) is int for value in (number, count)):
            raise ValueError("types differ")
        if not all(isinstance(identity[name], dict) for name in _VERSION):
            raise ValueError("no version")
        part = Part(number, count)
        return StoredPart(path.parent, str(found["kind"]), part, identity, dict(found["machine"]), complete)
    except (OSError, ValueError, KeyError, TypeError, UserError) as error:
        raise UserError(
            f"{path}: is damaged ({one_line(repr(error))}); remove its folder and run that part again"
        ) from error


def parts_in(shared: Path) -> list[StoredPart]:
    """All parts of a job, in order.

    UserError if there are none, one is missing, unfinished or there twice, or if they are not of one job, one
    version and the same settings.
    """
    found = sorted(stored_parts(shared), key=lambda one: one.part.number)
    if not found:
        raise UserError(f"{shared}: holds no parts; commands with --part I/N make them")
    _require_one_job(shared, found)
    count, folders = found[0].part.count, Counter(one.part for one in found)
    for part in (part for part, times in folders.items() if times > 1):
        names = " and ".join(sorted(one.folder.name for one in found if one.part == part))
        raise UserError(f"{shared}: {part} is there twice, in {names}; remove one")
    missing = [n for n in range(1, count + 1) if Part(n, count) not in folders]
    for numbers, what in (
        (missing, "missing"),
        ([one.part.number for one in found if not one.complete], "not finished"),
    ):
        if numbers:
            named = _joined(numbers)
            verb = "is" if len(numbers) == 1 else "are"
            raise UserError(f"{shared}: {named} of {count} {verb} {what}; run it with --part again")
    usual = Counter(json.dumps(one.identity, sort_keys=True) for one in found).most_common(1)[0][0]
    _require_same(shared, found, json.loads(usual), "others")
    return found


def machine_of(parts: Sequence[StoredPart]) -> dict[str, Any]:
    """What `machine` says of the machines of complete parts; all that they have where they differ."""
    own = {}
    for name, first in parts[0].machine.items():
        values = {str(one.machine.get(name)) for one in parts}
        own[name] = first if len(values) == 1 else ", ".join(sorted(values))
    return {**own, **parts[0].identity["machine"]}


def remove_parts(shared: Path, parts: Sequence[StoredPart]) -> None:
    """Removes the folders of parts when what they were joined to is complete."""
    shutil.rmtree(shared / _SHARED, ignore_errors=True)
    for one in parts:
        # The description goes last, so that an interrupted removal can go on.
        for path in one.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            elif path.name != _FILE:
                path.unlink()
        shutil.rmtree(one.folder)


def _joined(numbers: list[int]) -> str:
    """Numbers of parts in words, the first few of many."""
    if len(numbers) == 1:
        return f"part {numbers[0]}"
    shown = ", ".join(map(str, numbers[:8]))
    return f"parts {shown}{' and more' if len(numbers) > 8 else ''}"


def _require_one_job(shared: Path, parts: Sequence[StoredPart]) -> None:
    for values, what in (
        (sorted({one.kind for one in parts}), "several jobs"),
        (sorted({one.part.count for one in parts}), "jobs in different numbers of parts"),
    ):
        if len(values) > 1:
            raise UserError(
                f"{shared}: parts of {what} ({', '.join(map(str, values))}) lie side by side; "
                "give each job a folder"
            )


def _require_same(shared: Path, parts: Sequence[StoredPart], identity: dict[str, Any], who: str) -> None:
    """UserError if a part has another identity, which names what differs."""
    for one in parts:
        differing = [n for n in sorted({*identity, *one.identity}) if one.identity.get(n) != identity.get(n)]
        if not differing:
            continue
        if set(differing) <= {*_VERSION}:
            theirs, ours = _versions(one.identity), _versions(identity)
            name = next(n for n in sorted({*theirs, *ours}) if theirs.get(n) != ours.get(n))
            what = f"by another version: {name} {theirs.get(name)}, {who} {ours.get(name)}"
        else:
            what = f"with other settings ({one_line(', '.join(n for n in differing if n not in _VERSION))})"
        raise UserError(
            f"{shared}: {one.part} was made {what}; give each job a folder, "
            f"or remove {one.folder.name} and run it again"
        )


def _versions(identity: dict[str, Any]) -> dict[str, Any]:
    """What an identity says of the program: the source, the backend and the packages, by name."""
    code, machine = (dict(identity[name]) for name in _VERSION)
    packages = machine.pop("packages", {})
    return {**code, **machine, **packages}


def _write(part: StoredPart) -> None:
    content = {
        "kind": part.kind,
        "part": [part.part.number, part.part.count],
        "complete": part.complete,
        "machine": part.machine,
        "identity": part.identity,
    }
    write_text(part.folder / _FILE, json_text(content))
