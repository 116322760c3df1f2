"""Folders that several processes share, that are full, or that cannot be written."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.base.files import write_whole
from hybrid.base.identity import Journal
from hybrid.render.image_files import write_exr, write_mp4, write_srgb
from splat.io.gltf_gaussians import save_glb
from splat.io.ply import save_ply
from splat.io.tensors import load_tensors, save_tensors
from tests import small
from tests.extremes import extreme
from tests.splat.samples import gaussians


def processes(script: str, count: int, *arguments: object) -> list[str]:
    """What `count` processes print that run a script at the same time; each gets its number first."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    started = [
        subprocess.Popen(
            [sys.executable, "-c", script, str(number), *map(str, arguments)],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for number in range(count)
    ]
    outputs = [process.communicate()[0] for process in started]
    assert [process.returncode for process in started] == [0] * count
    return outputs


# Each writes the same file in 20 steps, and reads it: it is always one of those that somebody wrote.
_WRITER = """
import sys
from pathlib import Path
from compose.base.files import write_whole
number, file, rounds = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
torn = 0
for _ in range(rounds):
    def write(part):
        with part.open("w") as opened:
            for _ in range(20):
                opened.write(number * 4000)
                opened.flush()
    write_whole(file, write)
    text = file.read_text()
    torn += len(text) != 80_000 or len(set(text)) != 1
print(torn)
"""


@pytest.mark.parametrize(
    "count",
    [
        pytest.param(
            count,
            marks=extreme(
                f"{count} processes on one file",
                given="each writes it 40 times and reads it after each",
                expected="no torn file, no error, nothing left behind",
            ),
        )
        for count in (2, 4)
    ],
)
def test_processes_that_write_one_file_never_tear_it(count, tmp_path, got):
    torn = processes(_WRITER, count, tmp_path / "a.txt", 40)
    assert got(f"{sum(map(int, torn))} torn of {count * 40}").startswith("0 ")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


# Without the packages that take seconds to start: the journal alone.
_JOURNAL = """
import sys
from pathlib import Path
from hybrid.base.identity import Journal
number, file = sys.argv[1], Path(sys.argv[2])
journal = Journal(file, {"a": 1})
for n in range(10):
    journal[f"{number}-{n}"] = [n]
"""


@extreme(
    "2 processes on one journal",
    given="each saves 10 results of its own",
    expected="all 20 in the file",
)
def test_processes_that_share_a_journal_lose_no_result(tmp_path, got):
    processes(_JOURNAL, 2, tmp_path / "journal.json")
    journal = Journal(tmp_path / "journal.json", {"a": 1})
    assert got(sum(f"{number}-{n}" in journal for number in range(2) for n in range(10))) == 20
    assert [path.name for path in tmp_path.iterdir()] == ["journal.json"]


def _noise(side: int) -> np.ndarray:
    return small.rng().integers(0, 256, (side, side, 3), dtype=np.uint8)


def _mp4(path: Path) -> None:
    pytest.importorskip("av")
    write_mp4(path, iter([_noise(64)] * 8), (64, 64), 8)


WRITERS = {
    "a.txt": lambda path: write_whole(path, lambda part: part.write_text("x" * 100_000)),
    "a.png": lambda path: write_srgb(path, _noise(160)),
    "a.exr": lambda path: write_exr(path, {"": _noise(160) / np.float32(7)}),
    "a.safetensors": lambda path: save_tensors(path, {"a": torch.rand(20_000)}, {}),
    "a.ply": lambda path: save_ply(path, gaussians("overlap", n=900, degree=1)),
    "a.glb": lambda path: save_glb(path, gaussians("overlap", n=900, degree=1)),
    "a.mp4": _mp4,
}


@extreme(
    "disk full",
    given="files of at most 4 kB, for text, PNG, EXR, safetensors, PLY, GLB and MP4",
    expected="one line each, the file before unchanged, nothing left behind",
)
def test_a_full_disk_leaves_the_file_before(tmp_path, got):
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for name in WRITERS:
        (tmp_path / name).write_text("before")
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        for name, write in WRITERS.items():
            with pytest.raises(UserError, match=rf"{name}: cannot be written") as caught:
                write(tmp_path / name)
            assert "\n" not in str(caught.value)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(WRITERS, "before")
    got(f"{len(WRITERS)} refused")


@extreme(
    "disk full when synced",
    given="a disk that says so only when the content is to reach it",
    expected="one line, the file before unchanged",
)
def test_a_disk_that_is_full_late_leaves_the_file_before(tmp_path, monkeypatch, got):
    (tmp_path / "a").write_text("before")

    def full(file: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UserError, match=r"a: cannot be written \(No space left on device\)") as caught:
        write_whole(tmp_path / "a", lambda part: part.write_text("after"))
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "before"}
    got(str(caught.value).replace(str(tmp_path), ""))


@extreme(
    "read-only folder",
    given="a folder in which no file can be made",
    expected="one line, nothing changed",
)
def test_a_folder_that_is_read_only_is_named(tmp_path, monkeypatch, got):
    """Also as a user whom permissions do not bind."""
    (tmp_path / "a").write_text("before")
    touch = Path.touch

    def refused(path: Path, *arguments: object, **options: object) -> None:
        if path.parent == tmp_path:
            raise PermissionError(errno.EROFS, "Read-only file system")
        touch(path, *arguments, **options)

    monkeypatch.setattr(Path, "touch", refused)
    for write in WRITERS.values():
        with pytest.raises(UserError, match=r"a: cannot be written \(Read-only file system\)") as caught:
            write(tmp_path / "a")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "before"}
    got(str(caught.value).replace(str(tmp_path), ""))


# Writes tensors anew all the time.
_TENSORS = """
import sys, torch
from pathlib import Path
from splat.io.tensors import save_tensors
for n in range(40):
    save_tensors(Path(sys.argv[1]), {"a": torch.full((10_000,), float(n))}, {"n": n})
"""


@extreme(
    "tensors read while they are written",
    given="one process writes them 40 times, another reads them meanwhile",
    expected="each one whole",
)
def test_tensors_that_are_read_while_they_are_written_are_whole(tmp_path, got):
    save_tensors(tmp_path / "a", {"a": torch.zeros(10_000)}, {"n": 0})
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    writer = subprocess.Popen([sys.executable, "-c", _TENSORS, tmp_path / "a"], env=environment)
    read = whole = 0
    while writer.poll() is None:
        tensors, metadata = load_tensors(tmp_path / "a")
        whole += bool((tensors["a"] == metadata["n"]).all())
        read += 1
    assert writer.returncode == 0
    assert load_tensors(tmp_path / "a")[1] == {"n": 39}
    assert whole == read
    got("all whole")
