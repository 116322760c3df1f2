"""Files that are written atomically, and JSON that does no harm by a number, nesting or size."""

from __future__ import annotations

import math
import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from compose.base.errors import UserError
from compose.base.files import locked, parse_json, read_json, require_size_below, whole_folder, write_whole
from tests.extremes import extreme


def test_a_file_and_its_folder_are_made(tmp_path):
    target = tmp_path / "new" / "folder" / "notes.txt"
    write_whole(target, lambda part: part.write_text("content"))
    assert target.read_text() == "content"
    assert list(target.parent.iterdir()) == [target]


def test_the_target_is_replaced_only_when_it_is_complete(tmp_path):
    target = tmp_path / "notes.txt"
    target.write_text("old")
    seen = []

    def write(part: Path) -> None:
        part.write_text("new")
        seen.append(target.read_text())

    write_whole(target, write)
    assert seen == ["old"]
    assert target.read_text() == "new"


def test_the_partial_file_lies_beside_the_target_and_has_its_extension(tmp_path):
    parts = []
    write_whole(tmp_path / "image.exr", lambda part: parts.append(part) or part.touch())
    assert parts[0].parent == tmp_path
    assert parts[0].suffix == ".exr"
    assert parts[0].name != "image.exr"


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), RuntimeError("No space left on device")]
)
def test_a_failed_write_leaves_the_old_file_and_no_partial_one(tmp_path, error):
    target = tmp_path / "notes.txt"
    target.write_text("old")

    def write(part: Path) -> None:
        part.write_text("half")
        raise error

    with pytest.raises(UserError, match=r"notes.txt: cannot be written \(No space left on device\)"):
        write_whole(target, write)
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_an_interrupted_write_leaves_no_partial_file(tmp_path):
    def write(part: Path) -> None:
        part.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "notes.txt", write)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", ["", ".", "/"])
def test_a_path_without_a_name_is_refused(path, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="names a folder"):
        write_whole(Path(path), lambda part: part.write_text("content"))
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="cannot be written"):
        write_whole(tmp_path / "file" / "notes.txt", lambda part: part.write_text("content"))


def test_partial_files_of_two_writes_have_other_names(tmp_path):
    parts: list[Path] = []

    def write(part: Path) -> None:
        part.write_text("outer")
        parts.append(part)
        if len(parts) == 1:
            write_whole(tmp_path / "notes.txt", write)

    write_whole(tmp_path / "notes.txt", write)
    assert len({part.name for part in parts}) == 2
    assert all(part.name.startswith(".part-") for part in parts)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_a_file_has_the_permissions_of_an_ordinary_new_one(tmp_path, mask):
    """Also if a library lets only the owner read what it writes."""
    before = os.umask(mask)
    try:
        write_whole(tmp_path / "a", lambda part: (part.write_text("content"), part.chmod(0o600)))
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o666 & ~mask


def test_a_writer_that_writes_nothing_leaves_no_empty_file(tmp_path):
    with pytest.raises(UserError, match="cannot be written"):
        write_whole(tmp_path / "a", lambda part: None)
    assert not list(tmp_path.iterdir())


def test_content_and_name_reach_the_disk_in_this_order(tmp_path, monkeypatch):
    done = []
    sync, replace = os.fsync, os.replace
    monkeypatch.setattr(
        os, "fsync", lambda file: done.append(os.readlink(f"/proc/self/fd/{file}")) or sync(file)
    )
    monkeypatch.setattr(os, "replace", lambda *paths: done.append("rename") or replace(*paths))
    write_whole(tmp_path / "a", lambda part: part.write_text("content"))
    assert Path(done[0]).name.startswith(".part-")
    assert done[1:] == ["rename", str(tmp_path)]


def test_what_dead_processes_left_is_removed_and_what_is_being_written_stays(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    mine: list[str] = []
    write_whole(tmp_path / "a", lambda part: mine.append(part.name) or part.touch())
    place = mine[0].split("-")[1]
    names = {
        "of a dead process": f".part-{place}-{dead.pid}-0.txt",
        "of this process": f".part-{place}-{os.getpid()}-0.txt",
        "of another machine": ".part-00000000-1-0.txt",
        "of another machine, old": ".part-00000000-1-1.txt",
        "of no process": ".part-notes.txt",
    }
    for name in names.values():
        (tmp_path / name).touch()
    os.utime(tmp_path / names["of another machine, old"], (1, 1))
    write_whole(tmp_path / "a", lambda part: part.touch())
    removed = {what for what, name in names.items() if not (tmp_path / name).exists()}
    assert removed == {"of a dead process", "of another machine, old"}


def test_names_near_the_limit_are_written(tmp_path):
    name = "n" * 200 + "." + "e" * 50
    write_whole(tmp_path / name, lambda part: part.write_text("content"))
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["n" * 300, "a\0b"])
def test_a_name_that_no_file_can_have_is_refused(tmp_path, name):
    with pytest.raises(UserError, match="cannot be written") as caught:
        write_whole(tmp_path / name, lambda part: part.write_text("content"))
    assert "\0" not in str(caught.value)


def test_a_locked_folder_is_free_again_afterwards(tmp_path):
    for _ in range(2):
        with locked(tmp_path / "new"):
            assert (tmp_path / "new").is_dir()


def test_sizes_are_asked_for_before_reading(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    assert require_size_below(tmp_path / "a", 5) == 5
    with pytest.raises(ValueError, match="5 bytes; at most 4 are read"):
        require_size_below(tmp_path / "a", 4)
    with pytest.raises(ValueError, match="not a file"):
        require_size_below(Path("/dev/zero"), 4)
    with pytest.raises(FileNotFoundError):
        require_size_below(tmp_path / "b", 4)


def test_a_link_stays_and_its_file_is_written(tmp_path):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    for name, target in (("a", scratch / "a.txt"), ("b", scratch / "new.txt")):
        (tmp_path / name).symlink_to(target)
    (scratch / "a.txt").write_text("old")
    for name in "ab":
        write_whole(tmp_path / name, lambda part: part.write_text("new"))
        assert (tmp_path / name).is_symlink()
    assert [(scratch / name).read_text() for name in ("a.txt", "new.txt")] == ["new", "new"]
    assert sorted(os.listdir(scratch)) == ["a.txt", "new.txt"]


def test_links_in_a_circle_are_refused(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(UserError, match=r"a: cannot be written"):
        write_whole(tmp_path / "a", lambda part: part.write_text("new"))
    assert (tmp_path / "a").is_symlink()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_gets_the_content_or_nothing(tmp_path):
    pipe, got = tmp_path / "pipe.json", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_text()))
    reader.start()
    with pytest.raises(UserError, match="No space left"):
        write_whole(pipe, failed)
    write_whole(pipe, lambda part: part.write_text("content"))
    reader.join()
    assert got == ["content"]
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


def failed(part: Path) -> None:
    part.write_text("half")
    raise OSError(28, "No space left on device")


@pytest.mark.skipif(not Path("/dev/null").is_char_device(), reason="needs /dev/null")
def test_a_device_takes_the_content(tmp_path):
    (tmp_path / "null").symlink_to("/dev/null")
    for path in (tmp_path / "null", Path("/dev/null")):
        write_whole(path, lambda part: part.write_text("content"))
    assert (tmp_path / "null").is_symlink()
    assert Path("/dev/null").is_char_device()


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
@pytest.mark.parametrize("name", ["/dev/stdout", "/proc/self/fd/1", "link"])
def test_what_goes_to_the_standard_output_comes_between_what_is_printed(tmp_path, name):
    """Also where that is a file."""
    (tmp_path / "link").symlink_to("/dev/stdout")
    script = f"""
from pathlib import Path
from compose.base.files import write_whole
print("before")
write_whole(Path({name!r}), lambda part: part.write_text("content\\n"))
print("after")
"""
    with (tmp_path / "out.txt").open("wb") as out:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        subprocess.run([sys.executable, "-c", script], stdout=out, check=True, cwd=tmp_path, env=environment)
    assert (tmp_path / "out.txt").read_text().split() == ["before", "content", "after"]
    assert (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("is_there", [False, True])
def test_a_folder_appears_whole(tmp_path, is_there):
    target = tmp_path / "a"
    if is_there:
        target.mkdir()
    with whole_folder(target, "last") as part:
        for name in ("last", "z"):
            (part / name).write_text(name)
        assert not list(target.glob("[!.]*"))
    assert sorted(path.name for path in target.iterdir()) == ["last", "z"]
    assert list(tmp_path.iterdir()) == [target]
    with pytest.raises(UserError, match="a: exists already"), whole_folder(target, "last"):
        pass


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_a_folder_that_is_not_whole_does_not_appear(tmp_path, error):
    def write() -> None:
        with whole_folder(tmp_path / "a", "last") as part:
            (part / "z").write_text("z")
            raise error

    with pytest.raises((KeyboardInterrupt, UserError)):
        write()
    assert not list(tmp_path.iterdir())


def test_the_last_entry_of_a_folder_is_moved_last(tmp_path, monkeypatch):
    moved = []
    monkeypatch.setattr(os, "replace", lambda source, target: moved.append(Path(target).name))
    with whole_folder(tmp_path, "a") as part:
        for name in ("a", "b", "c"):
            (part / name).write_text(name)
    assert moved[-1] == "a"


def test_what_json_has_is_read(tmp_path):
    (tmp_path / "a").write_text('{"a": [1, -2.5, true, null, "ü"]}', encoding="utf-8")
    assert read_json(tmp_path / "a") == {"a": [1, -2.5, True, None, "ü"]}
    assert parse_json("NaN", finite=False) != parse_json("NaN", finite=False)
    assert math.isinf(parse_json("[-Infinity]", finite=False)[0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        pytest.param(
            "[" * 100_000,
            "nested too deeply",
            marks=extreme("deep JSON", given="100,000 lists in one another", expected="refused"),
        ),
        pytest.param(
            '{"a":' * 100_000 + "1" + "}" * 100_000,
            "nested too deeply",
            id="objects",
            marks=extreme("deep JSON objects", given="100,000 objects in one another", expected="refused"),
        ),
        pytest.param(
            "1e999",
            "1e999 is too large a number",
            marks=extreme("JSON number beyond doubles", given="1e999", expected="refused by name"),
        ),
        pytest.param(
            "9" * 1_000_000,
            "is too large a number",
            id="digits",
            marks=extreme("JSON number of a million digits", given="10^1000000 - 1", expected="refused"),
        ),
        ("-9223372036854775808", "is too large"),
        ("NaN", "NaN is not a number"),
        ("[Infinity]", "Infinity is not a number"),
        ("{", "Expecting"),
    ],
)
def test_what_it_has_not_is_refused(text, said, request):
    with pytest.raises(ValueError, match=said) as caught:
        parse_json(text)
    assert "\n" not in str(caught.value)
    if request.node.get_closest_marker("extremes"):
        request.getfixturevalue("got")(str(caught.value))


def test_files_that_are_too_large_or_no_text_are_refused(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff\xfe[1]")
    with pytest.raises(ValueError, match="can't decode"):
        read_json(tmp_path / "a")
    with pytest.raises(ValueError, match="5 bytes; at most 4"):
        read_json(tmp_path / "a", 4)


def test_a_byte_order_mark_does_no_harm(tmp_path):
    (tmp_path / "a").write_text('{"a": "ü"}', encoding="utf-8-sig")
    assert read_json(tmp_path / "a") == {"a": "ü"}
