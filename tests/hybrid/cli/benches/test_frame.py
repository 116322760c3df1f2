"""`hybrid bench frame`."""

from __future__ import annotations

import json
import subprocess

import pytest

from compose.base.errors import UserError
from hybrid.cli.bench import frame as command
from hybrid.cli.bench import on_llvm
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_each_mode_is_timed_still_and_live(made, backend, monkeypatch, tmp_path, capsys):
    out = tmp_path / "f.json"
    common = ["bench", command.__name__, "cornell", "--forest", made / "box.forest", "--json", out]
    name_of_backend = backend.variant.split("_")[0]
    few = ["--repeats", 3, "--warm-up", 1, "--backend", name_of_backend]
    assert run(monkeypatch, *common, "--size", 48, 32, *few) == 0
    rows = json.loads(out.read_text())
    names = [(row["mode"], "live" if row["live"] else "still") for row in rows]
    assert names == [
        (mode, renderer) for mode in ("raw", "denoised", "fused") for renderer in ("still", "live")
    ]
    header, *lines = capsys.readouterr().out.splitlines()
    assert header.split()[:4] == ["backend", "size", "fovea", "renderer"]
    for line, row, name in zip(lines, rows, names, strict=True):
        cells = line.split()
        assert cells[:4] == [name_of_backend, "48x32", *name]
        assert cells[7:9] == [str(row["launches"]), f"{row['host_bytes']:,}"]


def test_a_size_of_nothing_is_refused(monkeypatch, capsys):
    assert run(monkeypatch, "bench", command.__name__, "cornell", "--size", 0, 32) == 2
    assert capsys.readouterr().err == "hybrid: --size 0 32: must be positive\n"


def test_the_other_backend_has_a_process_of_its_own(monkeypatch):
    def process(arguments, **_):
        assert arguments[1:] == [
            *("-m", "hybrid.cli.main", "bench", "frame", "room", "--json", "mine.json"),
            *("--backend", "llvm", "--json", arguments[-1]),
        ]
        with open(arguments[-1], "w") as file:
            json.dump([{"backend": "llvm"}], file)
        return subprocess.CompletedProcess(arguments, 0)

    monkeypatch.setattr(subprocess, "run", process)
    assert on_llvm(["bench", "frame", "room", "--json", "mine.json"]) == [{"backend": "llvm"}]


def test_a_process_that_fails_is_named(monkeypatch):
    failed = subprocess.CompletedProcess([], 3)
    monkeypatch.setattr(subprocess, "run", lambda *args, **options: failed)
    with pytest.raises(UserError, match=r"^backend llvm: its process ended with exit code 3"):
        on_llvm(["bench", "frame", "room"])
