"""`hybrid sweep`: its options and what it prints; sweeps themselves are tested in their own room."""

from __future__ import annotations

import json

import pytest

from hybrid.cli import sweep as command
from hybrid.evaluation import evaluation_page
from hybrid.evaluation import sweep_run as module
from hybrid.evaluation.sweep_catalogue import SweepEffort
from hybrid.preparation.scene_plan import as_planned
from hybrid.render.frame_settings import SWEEP, FrameSettings
from pathtrace.scene.scene import load_scene
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")
ROWS = [
    {"spp": 1, "ms": {"p50": 101.6}, "full_ms": {"p50": 512.0}, "covered": 0.125, "ratio": 5.04},
    {"spp": 2, "ms": {"p50": 180.2}, "full_ms": {"p50": 900.0}, "covered": 0.125, "ratio": 4.99},
]
CONTENT = {"scene": "cornell", "title": "samples per pixel", "rows": ROWS, "break_even": []}


@pytest.fixture
def sweep(made, monkeypatch):
    """Runs the command with options; returns its exit code and what the sweep was given."""
    notes = []

    def noting(scene, forest, over, base, effort, write, progress):
        notes.append((over, base.camera, base.frame, effort))
        write(CONTENT)
        progress(1, 2)
        return CONTENT

    monkeypatch.setattr(module, "sweep", noting)
    common = [command.sweep.__name__, "cornell", "--forest", made / "box.forest"]
    return lambda *options: (run(monkeypatch, *common, *options), notes)


def test_without_options_resolutions_are_swept_as_the_paper_does(sweep):
    code, given = sweep()
    assert code == 0
    assert given == [("resolution", as_planned(load_scene("cornell")).camera, SWEEP, SweepEffort(15, 2, 64))]


def test_every_option_reaches_the_sweep(sweep):
    options = ["--over", "acuity", "--size", 40, 30, "--fov-a", 30, "--fov-b", 10, "--spp", 3]
    options += ["--fovea", "fused", "--display", "hmd", "--repeats", 4, "--warm-up", 5, "--reference-spp", 6]
    code, given = sweep(*options)
    assert code == 0
    camera = as_planned(load_scene("cornell")).camera.resized(40, 30)
    settings = FrameSettings(fov_a=30, fov_b=10, spp=3, fovea="fused", display="hmd", fill=False)
    assert given == [("acuity", camera, settings, SweepEffort(4, 5, 6))]
    code, given = sweep("--over", "band", "--acuity-model", "fov-gs")
    assert code == 0
    assert given[-1][2].acuity_model == "fov-gs"


def test_the_table_is_printed_and_written(sweep, tmp_path, capsys):
    code, _ = sweep("--over", "spp", "--json", tmp_path / "s.json")
    assert code == 0
    assert json.loads((tmp_path / "s.json").read_text()) == CONTENT
    title, head, *rows = capsys.readouterr().out.splitlines()
    assert title == "cornell: samples per pixel, raw fovea"
    assert head.split() == ["spp", "covered,", "%", "ms", "full,", "ms", "ratio"]
    assert [row.split() for row in rows] == [
        ["1", "12.5", "102", "512", "5.04"],
        ["2", "12.5", "180", "900", "4.99"],
    ]
    assert len({len(line) for line in (head, *rows)}) == 1


def test_measured_quality_is_printed_too(sweep, monkeypatch, capsys):
    measured = {"whole ssim": 0.98765, "whole psnr": 30.0, "foveal jod": 9.123}
    monkeypatch.setitem(CONTENT, "rows", [{**row, "fovea": "raw", "quality": measured} for row in ROWS])
    assert sweep("--over", "band")[0] == 0
    title, head, *rows = capsys.readouterr().out.splitlines()
    assert title == "cornell: samples per pixel"
    assert head.endswith("whole ssim  foveal jod")
    assert all(row.endswith("    0.9877       9.123") for row in rows)


def test_a_sweep_joins_the_page_of_an_evaluation(sweep, monkeypatch, tmp_path, capsys):
    written = []
    monkeypatch.setattr(evaluation_page, "evaluated_scene", lambda folder: "cornell")
    monkeypatch.setattr(
        evaluation_page,
        "write_report",
        lambda folder: written.append(sorted(p.name for p in folder.iterdir())),
    )
    assert sweep("--over", "spp", "--report", tmp_path)[0] == 0
    assert written == [["sweep-spp.json"]]
    assert json.loads((tmp_path / "sweep-spp.json").read_text()) == CONTENT
    assert capsys.readouterr().out.splitlines()[-1] == str(tmp_path / "index.html")


def test_the_page_of_another_scene_is_refused_before_the_sweep(sweep, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(evaluation_page, "evaluated_scene", lambda folder: "room")
    code, given = sweep("--over", "spp", "--report", tmp_path)
    assert (code, given) == (2, [])
    said = f"hybrid: --report {tmp_path}: holds an evaluation of room, not of cornell\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    ("over", "options"),
    [
        ("resolution", ["--size", 40, 30]),
        ("spp", ["--spp", 2]),
        ("radius", ["--reference-spp", 8]),
        ("band", ["--fov-a", 30]),
        ("band", ["--fov-b", 10]),
        ("acuity", ["--acuity-model", "none"]),
        ("denoiser", ["--fovea", "raw"]),
        ("trade", ["--spp", 1]),
    ],
)
def test_an_option_without_influence_is_refused(over, options, sweep, capsys):
    code, given = sweep("--over", over, *options)
    assert (code, given) == (2, [])
    said = f"hybrid: {options[0]}: has no influence on a sweep --over {over}; leave it out\n"
    assert capsys.readouterr().err == said
