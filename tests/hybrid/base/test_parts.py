"""Parts of a job: what each takes, where it writes, and what does not fit together."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from compose.base.errors import UserError
from hybrid.base.identity import Journal
from hybrid.base.parts import Part, begin, first_come, part_named, parts_in, remove_parts, stored_parts
from tests.extremes import extreme

IDENTITY = {
    "scene": "ab" * 32,
    "settings": {"size": [4, 5]},
    "code": {"source": "1a2b", "mitsuba-oidn": None},
    "machine": {"cpu": "fast", "cores": 64, "gpu": None, "backend": "llvm", "packages": {"numpy": "2.0"}},
}


def changed(**values: object) -> dict:
    """The identity with other values, of whichever of its parts has them."""
    found = deepcopy(IDENTITY)
    for name, value in values.items():
        next(one for one in (found, found["code"], found["machine"]) if name in one)[name] = value
    return found


@pytest.fixture
def shared(tmp_path) -> Path:
    """A folder with four finished parts."""
    for number in range(1, 5):
        begin(tmp_path, "sweep", Part(number, 4), IDENTITY).finish()
    return tmp_path


@given(st.integers(1, 40), st.integers(0, 200))
def test_parts_take_everything_once(count, pieces):
    parts = [Part(number, count) for number in range(1, count + 1)]
    taken = [[index for index in range(pieces) if part.takes(index)] for part in parts]
    assert sorted(index for of_part in taken for index in of_part) == list(range(pieces))
    # As evenly as can be.
    assert max(map(len, taken)) - min(map(len, taken)) <= 1


@extreme(
    "names of parts",
    given="0/4, 5/4, 2/0, 1/100000, -1/4, x, 2, 2/4/1, 1e0/4, a number of 20 digits, digits of other scripts",
    expected="each refused in one line",
)
def test_what_is_no_part_is_refused(got):
    names = ["0/4", "5/4", "2/0", "1/100000", "-1/4", "x", "", "2", "2/4/1", "1e0/4", "1/" + "9" * 20, "١/٢"]
    for name in names:
        with pytest.raises(UserError, match=rf"^part {name}: must be I/N") as caught:
            part_named(name)
        assert "\n" not in str(caught.value)
    got(f"{len(names)} refused")
    assert part_named("2/4") == Part(2, 4)
    assert part_named("10000/10000") == Part(10_000, 10_000)
    assert Part() == Part(1, 1)


def test_all_parts_are_found_in_order_with_their_machines(tmp_path):
    for number in (10, 2, 9, 1, 3, 4, 5, 6, 7, 8):
        begin(tmp_path, "sweep", Part(number, 10), changed(cpu=f"cpu {number}", cores=number)).finish()
    found = parts_in(tmp_path)
    assert [one.part.number for one in found] == list(range(1, 11))
    assert [one.machine for one in found] == [
        {"cpu": f"cpu {n}", "cores": n, "gpu": None} for n in range(1, 11)
    ]
    assert {one.kind for one in found} == {"sweep"}
    assert found[0].identity["machine"] == {"backend": "llvm", "packages": {"numpy": "2.0"}}


def lost(shared: Path) -> None:
    shutil.rmtree(shared / "part-3-of-4")


def two_lost(shared: Path) -> None:
    lost(shared)
    shutil.rmtree(shared / "part-1-of-4")


def copied(shared: Path) -> None:
    shutil.copytree(shared / "part-2-of-4", shared / "copy")


def of_two(shared: Path) -> None:
    edit(shared, 1, part=[1, 2])


def unfinished(shared: Path) -> None:
    edit(shared, 3, complete=False)


def edit(shared: Path, number: int, **values: object) -> None:
    """Changes what the description of a part says."""
    file = shared / f"part-{number}-of-4" / "part.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **values}))


def of_other(**values: object):
    """Makes the third part one of another identity."""

    def change(shared: Path) -> None:
        identity = changed(**values)
        for name in ("cpu", "cores", "gpu"):
            del identity["machine"][name]
        edit(shared, 3, identity=identity)

    return change


WRONG = {
    "lost": (lost, "part 3 of 4 is missing"),
    "two lost": (two_lost, "parts 1, 3 of 4 are missing"),
    "doubled": (copied, "part 2 of 4 is there twice, in copy and part-2-of-4"),
    "of two counts": (of_two, r"jobs in different numbers of parts \(2, 4\)"),
    "of two kinds": (lambda shared: edit(shared, 1, kind="capture"), r"several jobs \(capture, sweep\)"),
    "unfinished": (unfinished, "part 3 of 4 is not finished"),
    "another source": (
        of_other(source="3c4d"),
        "part 3 of 4 was made by another version: source 3c4d, others 1a2b",
    ),
    "another package": (
        of_other(packages={"numpy": "1.9"}),
        "part 3 of 4 was made by another version: numpy 1.9, others 2.0",
    ),
    "another backend": (
        of_other(backend="cuda"),
        "part 3 of 4 was made by another version: backend cuda, others llvm",
    ),
    "other settings": (
        of_other(settings={"size": [4, 6]}),
        r"part 3 of 4 was made with other settings \(settings\)",
    ),
    "damaged": (lambda shared: edit(shared, 3, part=[7, 4]), r"part-3-of-4/part.json: is damaged"),
}


@pytest.mark.parametrize(
    "what",
    [
        pytest.param(
            name,
            marks=extreme(
                f"parts, {name}", given=f"four parts, {name}", expected="one line names it, nothing changes"
            ),
        )
        for name in WRONG
    ],
)
def test_parts_that_do_not_fit_are_named(what, shared, got):
    change, said = WRONG[what]
    assert len(parts_in(shared)) == 4
    change(shared)
    before = {path: path.read_bytes() for path in shared.rglob("*") if path.is_file()}
    with pytest.raises(UserError, match=said) as caught:
        parts_in(shared)
    assert "\n" not in str(caught.value)
    assert {path: path.read_bytes() for path in shared.rglob("*") if path.is_file()} == before
    got(str(caught.value).replace(str(shared), ""))


def test_a_folder_without_parts_is_named(tmp_path):
    with pytest.raises(UserError, match=f"^{tmp_path}: holds no parts"):
        parts_in(tmp_path)


def test_what_parts_used_must_be_the_same_too(tmp_path):
    """Such as what one of them made for all, where the file system has no locks."""
    for number, rays in ((1, 5), (2, 5), (3, 6)):
        begin(tmp_path, "sweep", Part(number, 3), IDENTITY).finish(rays=rays)
    with pytest.raises(UserError, match=r"part 3 of 3 was made with other settings \(rays\)"):
        parts_in(tmp_path)


def test_a_part_that_is_run_again_finds_its_folder(tmp_path):
    first = begin(tmp_path, "sweep", Part(2, 3), IDENTITY)
    assert not first.complete
    first.finish(rays=5)
    written = (first.folder / "part.json").read_bytes()
    # On another machine, too.
    assert begin(tmp_path, "sweep", Part(2, 3), changed(cpu="slow")).folder == first.folder
    assert (first.folder / "part.json").read_bytes() == written


@pytest.mark.parametrize(
    ("kind", "part", "values", "said"),
    [
        (
            "sweep",
            Part(2, 3),
            {"source": "3c4d"},
            "part 2 of 3 was made by another version: source 1a2b, this",
        ),
        # Before it spends hours on what cannot be merged.
        (
            "sweep",
            Part(1, 3),
            {"source": "3c4d"},
            "part 2 of 3 was made by another version: source 1a2b, this",
        ),
        ("sweep", Part(1, 3), {"scene": "cd"}, r"part 2 of 3 was made with other settings \(scene\)"),
        ("sweep", Part(1, 2), {}, r"different numbers of parts \(2, 3\)"),
        ("capture", Part(1, 3), {}, r"several jobs \(capture, sweep\)"),
    ],
)
def test_a_part_of_another_job_or_version_is_refused_before_it_begins(tmp_path, kind, part, values, said):
    begin(tmp_path, "sweep", Part(2, 3), IDENTITY)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(UserError, match=said):
        begin(tmp_path, kind, part, changed(**values))
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="file: cannot be written"):
        begin(tmp_path / "file", "sweep", Part(), IDENTITY)


# Each waits for the others to come as well, then makes a number that only itself would make.
_FIRST = """
import sys, time
from pathlib import Path
from hybrid.base.identity import Journal
from hybrid.base.parts import first_come
number, folder = int(sys.argv[1]), Path(sys.argv[2])
(folder / f"here-{number}").touch()
while len(list(folder.glob("here-*"))) < 3:
    time.sleep(0.001)
def make():
    (folder / f"made-{number}").touch()
    return number
with first_come(folder) as common:
    print(Journal(common / "rays.json", {}).once("rays", make))
"""


@extreme(
    "3 parts that come at once",
    given="processes that ask for what one makes for all, at the same time",
    expected="made once, the same for all",
)
def test_what_all_parts_use_is_made_once(tmp_path, got):
    started = [
        subprocess.Popen([sys.executable, "-c", _FIRST, str(n), str(tmp_path)], stdout=subprocess.PIPE)
        for n in range(3)
    ]
    printed = {process.communicate()[0].strip() for process in started}
    assert [process.returncode for process in started] == [0] * 3
    made = [path.name for path in tmp_path.glob("made-*")]
    assert got(f"{len(made)} made, {len(printed)} read") == "1 made, 1 read"


def test_parts_are_removed_with_what_they_shared(shared):
    with first_come(shared) as common:
        Journal(common / "rays.json", {})["rays"] = 5
    (shared / "part-1-of-4" / "frames").mkdir()
    (shared / "result.json").write_text("{}")
    remove_parts(shared, parts_in(shared))
    assert [path.name for path in shared.iterdir()] == ["result.json"]
    assert stored_parts(shared) == []
