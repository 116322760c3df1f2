"""Numbers at the ends of all options: refused in one line, before anything is loaded, traced or trained."""

from __future__ import annotations

import json

import pytest

from compose.base.errors import MOST_SEED
from tests.extremes import extreme
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")

RENDER = ["render", "cornell", "-o", "{tmp}/a.png"]
VIDEO = ["render", "cornell", "-o", "{tmp}/a.mp4", "--gaze-trace", "{tmp}/trace.csv"]
CAPTURE, TRAIN = ["capture", "cornell", "{tmp}/f"], ["train", "{tmp}/f", "{tmp}/g"]
EVALUATE = ["evaluate", "cornell", "--report", "{tmp}/r"]
DEMO, SWEEP = ["demo", "cornell", "--out", "{tmp}"], ["sweep", "cornell"]
RASTER, FRAME = ["bench", "raster"], ["bench", "frame", "cornell"]
INTEGRATOR = ["bench", "integrator", "cornell"]
SEEDED = (RENDER, CAPTURE, TRAIN, EVALUATE, DEMO, RASTER, ["quickstart", "--out", "{tmp}/o"])

REFUSED = [
    *[
        (command, ["--seed", seed], "seed")
        for command in SEEDED
        for seed in (str(1 << 64), "-1", "nan", "1.5")
    ],
    *[
        (command, ["--gaze", x, "0.5"], "gaze")
        for command in (RENDER, EVALUATE)
        for x in ("1e308", "-1e308", "1001", "inf", "nan")
    ],
    *[
        (command, [option, value], option[2:])
        for command in (RENDER, EVALUATE, DEMO, SWEEP, FRAME)
        for option in ("--fov-a", "--fov-b")
        for value in ("-1", "nan", "inf", "1e999")
    ],
    *[
        (command, ["--spp", value], "spp")
        for command in (RENDER, EVALUATE, DEMO, SWEEP, FRAME, CAPTURE)
        for value in ("0", "-1", str((1 << 24) + 1), "nan", str(1 << 70))
    ],
    *[
        (command, ["--size", *size], "size")
        for command in (DEMO, RASTER)
        for size in (("0", "64"), ("64", "-1"))
    ],
    *[
        (command, ["--size", *size], f"--size {' '.join(size)}: must be at most 16384 each")
        for command in (CAPTURE, EVALUATE, DEMO, RASTER)
        for size in (("1000000000", "64"), ("64", str(1 << 70)))
    ],
    *[(EVALUATE, ["--size", "64", value], f"height {value}: must be positive") for value in ("0", "-1")],
    *[(RENDER, ["--max-depth", value], "max-depth") for value in ("0", "-1", str(1 << 40))],
    *[(RENDER, ["--fps", value], "fps") for value in ("0", "241")],
    *[(RENDER, ["--target-ms", value], "target-ms") for value in ("-1", "nan", "inf")],
    *[(RENDER, ["--target-jod", value], "target-jod") for value in ("10.1", "nan", "-inf")],
    *[(RENDER, ["--layers", *value], "layers") for value in (("0", "1"), ("3", "2"), ("-1", "-1"))],
    *[(CAPTURE, ["--views", value], "views") for value in ("0", "-1", str(1 << 40))],
    *[(CAPTURE, ["--held-out", value], "held-out") for value in ("-1", str(1 << 40))],
    *[(CAPTURE, ["--held-out-spp", value], "held-out-spp") for value in ("0", str(1 << 40))],
    *[(TRAIN, ["--iterations", value], "iterations") for value in ("0", "-1", str(1 << 62))],
    *[(TRAIN, ["--gaussians", value], "gaussians") for value in ("0", "-1", str(1 << 62))],
    *[(TRAIN, ["--layers", value], "layers") for value in ("0", "-1")],
    *[(TRAIN, ["--degree", value], "degree") for value in ("-1", "4", str(1 << 62))],
    *[(EVALUATE, ["--views", value], "views") for value in ("0", str(1 << 40))],
    *[(EVALUATE, ["--reference-spp", value], "reference-spp") for value in ("3", str(1 << 24))],
    *[(EVALUATE, ["--repeats", value], "repeats") for value in ("2", str(1 << 40))],
    (EVALUATE, ["--gaze", "0", "0", "--fov-a", "1.9", "--fov-b", "1.4"], "fov-a 1.9"),
    (EVALUATE, ["--fov-a", "0.05", "--fov-b", "0"], "the foveal region of this frame is empty"),
    (EVALUATE, ["--fov-a", "0.3", "--fov-b", "0"], "must be at least 4 x 4 for FovVideoVDP"),
    (EVALUATE, ["--fov-a", "20", "--fov-b", "19.999"], "the seam region of this frame is empty"),
    (EVALUATE, ["--size", "1024", "12"], "size 1024 12: must be at least 22 each to be evaluated"),
    (EVALUATE, ["--size", "21", "512"], "size 21 512: must be at least 22 each to be evaluated"),
    *[(DEMO, ["--target", value], "target") for value in ("0", "nan", "inf", "1e308")],
    *[(DEMO, ["--latency", value], "latency") for value in ("-1", "nan", "inf", "1e308")],
    *[(DEMO, ["--bench", value], "bench") for value in ("0", "nan", "inf", "1e308")],
    *[(DEMO, ["--bench", "5", "--load", value], "load") for value in ("-1", "nan", "inf", "1e308")],
    *[(SWEEP, ["--reference-spp", value], "reference-spp") for value in ("3", str(1 << 24))],
    *[(FRAME, ["--repeats", value], "repeats") for value in ("2", str(1 << 40))],
    *[(FRAME, ["--warm-up", value], "warm-up") for value in ("0", str(1 << 40))],
    *[(INTEGRATOR, ["--reference-spp", value], "reference-spp") for value in ("3", str(1 << 24))],
    *[(RASTER, ["--gaussians", value], "gaussians") for value in ("0", str(1 << 40))],
    *[(RASTER, ["--repeats", value], "repeats") for value in ("2", str(1 << 40))],
    *[(RENDER, ["--display", f"{{tmp}}/{name}.json"], name) for name in ("needle", "flat", "naught")],
    (EVALUATE, ["--display", "{tmp}/dense.json"], "pixels per degree are more than the 10000"),
]


@pytest.fixture
def nothing_is_loaded(monkeypatch):
    """Loading a scene fails; frame sets and forests that these commands name do not exist."""
    monkeypatch.setattr("pathtrace.scene.scene.scene_file", None)


@pytest.mark.parametrize(("command", "options", "named"), REFUSED)
def test_numbers_beyond_the_ends_are_refused(
    command, options, named, nothing_is_loaded, monkeypatch, tmp_path, capsys
):
    displays = {"needle": (1920, 1e-45), "flat": (1920, 180.0), "naught": (0, 55.0), "dense": (10**9, 55.0)}
    for name, (width, fov) in displays.items():
        (tmp_path / f"{name}.json").write_text(json.dumps({"width": width, "height": 1080, "fov": fov}))
    before = set(tmp_path.rglob("*"))
    filled = [argument.format(tmp=tmp_path) for argument in (*command, *options)]
    assert run(monkeypatch, *filled) == 2
    message = capsys.readouterr().err
    assert named in message
    assert "Traceback" not in message
    if message.startswith("hybrid:"):
        assert message.count("\n") == 1
    assert set(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("name", "rows", "named"),
    [
        ("far", "0,0.5,0.5\n1,1e308,0.5\n", "trace.csv: line 3 is not a gaze (1,1e308,0.5)"),
        ("long", "0,0.5,0.5\n1,0.5,0.5\n1e12,0.5,0.5\n", "trace.csv: line 4: time 1e12 is 1e+12 s after"),
        ("endless", "-1e308,0.5,0.5\n1e308,0.5,0.5\n", "trace.csv: line 3: time 1e308 is inf s after"),
        ("infinite", "0,0.5,0.5\ninf,0.5,0.5\n", "trace.csv: line 3: time inf must be a number"),
    ],
)
@pytest.mark.parametrize(
    "command", [VIDEO, [*DEMO, "--gaze-trace", "{tmp}/trace.csv"]], ids=["video", "demo"]
)
def test_traces_that_cannot_be_shown_are_refused_by_line(
    name, rows, named, command, nothing_is_loaded, monkeypatch, tmp_path, capsys
):
    (tmp_path / "trace.csv").write_text(f"seconds,x,y\n{rows}")
    assert run(monkeypatch, *[argument.format(tmp=tmp_path) for argument in command]) == 2
    message = capsys.readouterr().err
    assert named in message
    assert message.count("\n") == 1


@extreme("a video of too many frames", given="20,000 s at 60 frames per second", expected="refused by line")
def test_a_video_has_a_number_of_frames_at_most(nothing_is_loaded, monkeypatch, tmp_path, capsys, got):
    (tmp_path / "trace.csv").write_text("seconds,x,y\n0,0.5,0.5\n20000,0.5,0.5\n")
    video = [argument.format(tmp=tmp_path) for argument in VIDEO]
    assert run(monkeypatch, *video, "--fps", 60) == 2
    message = got(capsys.readouterr().err.strip().rpartition("/")[2])
    assert (
        message == "trace.csv: line 3: time 20000 is 20000 s after the first one; must be at most 16666.7 s"
    )


@extreme("the largest seed", given=f"--seed {MOST_SEED}", expected="a frame; one more is refused")
def test_the_largest_seed_works(made, monkeypatch, tmp_path, got):
    command = [
        "render",
        "cornell",
        "--forest",
        made / "box.forest",
        "-o",
        tmp_path / "a.png",
        "--size",
        32,
        32,
    ]
    assert got(run(monkeypatch, *command, "--seed", MOST_SEED)) == 0
    assert got(run(monkeypatch, *command, "--seed", MOST_SEED + 1)) == 2


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(
            options, marks=extreme(f"render {' '.join(options)}", given="cornell, 32x32", expected="a frame")
        )
        for options in (
            ["--fov-a", "1e-6", "--fov-b", "0"],
            ["--fov-a", "1e6", "--fov-b", "0"],
            ["--fov-a", "200", "--fov-b", "200"],
            ["--gaze", "1000", "-1000"],
            ["--size", "1", "1"],
            ["--size", "1", "512"],
            ["--size", "512", "1"],
        )
    ],
)
def test_options_at_their_ends_work(options, made, monkeypatch, tmp_path, got):
    forest = ["--forest", made / "box.forest"]
    size = [] if "--size" in options else ["--size", 32, 32]
    assert got(run(monkeypatch, "render", "cornell", *forest, *size, *options, "-o", tmp_path / "a.png")) == 0
    assert (tmp_path / "a.png").stat().st_size > 0
