"""Sweeps in parts, and what they become."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from compose.base.errors import UserError
from hybrid.base.identity import Journal, machine
from hybrid.base.parts import Part
from hybrid.evaluation import sweep_catalogue as catalogue
from hybrid.evaluation import sweep_run as module
from hybrid.evaluation.sweep_catalogue import SweepEffort
from hybrid.evaluation.sweep_run import merged_sweep, swept
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home", "quick_metrics")
# What is timed differs each time.
TIMED = {"ms", "ms_range", "full_ms", "ratio", "ratio_range", "ratio_interval", "passes"}


@pytest.fixture
def radius(made, monkeypatch) -> Callable[..., int]:
    """Runs a sweep over two sizes and radii, with options."""
    monkeypatch.setattr(catalogue, "FPC_BREAK_EVEN", {(48, 32): 51.0, (64, 32): 50.0})
    monkeypatch.setattr(catalogue, "_RADII", (20, 90))
    common = ["sweep", "cornell", "--forest", made / "box.forest", "--repeats", 3, "--warm-up", 1]
    return lambda *options: run(monkeypatch, *common, "--over", "radius", *options)


def untimed(row: dict) -> dict:
    return {name: value for name, value in row.items() if name not in TIMED}


def test_a_sweep_in_parts_is_that_of_one_machine(radius, monkeypatch, tmp_path, capsys):
    """A third part has nothing to do."""
    assert radius("--json", tmp_path / "whole.json") == 0
    whole, shared = json.loads((tmp_path / "whole.json").read_text()), tmp_path / "parts"
    title, head = capsys.readouterr().out.splitlines()[:2]
    for number in (3, 1, 2):
        assert radius("--shared", shared, "--part", f"{number}/3") == 0
    assert "part 2 of 3 in" in capsys.readouterr().out
    assert run(monkeypatch, "merge", shared, "--json", tmp_path / "merged.json") == 0
    merged = json.loads((tmp_path / "merged.json").read_text())
    assert list(merged) == list(whole)
    assert [untimed(row) for row in merged["rows"]] == [untimed(row) for row in whole["rows"]]
    assert all(row["ms"]["p50"] > 0 for row in merged["rows"])
    for name in merged.keys() - {"rows", "break_even"}:
        assert merged[name] == whole[name]
    assert [(row["width"], row["paper"]) for row in merged["break_even"]] == [(48, 51.0), (64, 50.0)]
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == title
    assert shown[1].split() == head.split()
    assert len(shown) == 2 + 4 + 2


def test_quality_of_a_group_is_the_same_whatever_else_is_measured(base, corner, rough, tmp_path):
    sizes = ((48, 32), (36, 24), (24, 16))
    settings = [
        replace(base, camera=base.camera.resized(*size), frame=replace(base.frame, fov_a=radius), varied={})
        for size in sizes
        for radius in (40.0, 60.0)
    ]

    def quality(name: str, *takes: Callable[[int], bool]) -> list[dict]:
        journal = Journal(tmp_path / f"{name}.json", {})
        rows = swept(corner, rough, settings, True, SweepEffort(3, 1, 4), journal, lambda *_: None, *takes)
        return [row["quality"] for row in rows]

    whole = quality("whole")
    first, second = (quality(str(number), Part(number, 2).takes) for number in (1, 2))
    assert [*first[:2], *second, *first[2:]] == whole
    assert whole[0] != whole[2]


def test_a_part_resumes_where_it_was_interrupted(radius, monkeypatch, tmp_path):
    timed, times = module.interleaved_passes, []

    def interrupted(*arguments):
        if len(times) == 1:
            raise KeyboardInterrupt
        times.append(timed(*arguments))
        return times[-1]

    monkeypatch.setattr(module, "interleaved_passes", interrupted)
    assert radius("--shared", tmp_path, "--part", "1/1") == 130
    with pytest.raises(UserError, match="part 1 of 1 is not finished"):
        merged_sweep(tmp_path)
    times.clear()
    assert radius("--shared", tmp_path, "--part", "1/1") == 0
    assert len(times) == 1
    assert len(merged_sweep(tmp_path)["rows"]) == 4


def test_machines_of_several_parts_are_all_named(radius, tmp_path):
    for number in (1, 2):
        assert radius("--shared", tmp_path, "--part", f"{number}/2") == 0
    file = tmp_path / "part-2-of-2" / "part.json"
    found = json.loads(file.read_text())
    own = found["machine"]
    file.write_text(json.dumps({**found, "machine": {**own, "cpu": "another"}}))
    said = merged_sweep(tmp_path)["machine"]
    assert said == {**machine(), "cpu": ", ".join(sorted(["another", own["cpu"]]))}


def test_lost_rows_of_a_finished_part_are_named(radius, tmp_path):
    assert radius("--shared", tmp_path, "--part", "1/1") == 0
    rows = Path(tmp_path / "part-1-of-1" / "rows.json")
    rows.unlink()
    with pytest.raises(UserError, match=r"part-1-of-1/rows.json: is missing"):
        merged_sweep(tmp_path)


def test_a_part_of_another_sweep_is_refused(radius, tmp_path, capsys):
    assert radius("--shared", tmp_path, "--part", "1/2") == 0
    assert radius("--shared", tmp_path, "--part", "2/2", "--spp", 2) == 2
    assert "part 1 of 2 was made with other settings (settings)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--part", "1/2"], "--part and --shared: a part needs both"),
        (["--shared", "f"], "--part and --shared: a part needs both"),
        (["--part", "1/2", "--shared", "f", "--report", "r"], "--report: has no influence on parts"),
        (["--part", "1/2", "--shared", "f", "--json", "a.json"], "--json: has no influence on a part"),
        (["--part", "3/2", "--shared", "f"], "--part 3/2: must be I/N"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, said, radius, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert radius(*options) == 2
    assert f"hybrid: {said}" in capsys.readouterr().err
    assert not (tmp_path / "f").exists()
