"""`hybrid train` and `hybrid render` of folders of frames of others."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from PIL import Image

from compose.camera.coordinate_systems import camera_to_json
from compose.image.exr import read_channels
from tests import posed
from tests.extremes import extreme
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend")
TRAINING = ["--iterations", "60", "--gaussians", "600", "--degree", "0", "--layers", "2"]


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A folder of frames, the forest that was trained on it, and what training said."""
    at = tmp_path_factory.mktemp("ball")
    posed.write_synthetic(at / "ball", training=8, held_out=3)
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setenv("HYBRID_HOME", str(at / "home"))
        out = ["--json", at / "t.json"]
        assert run(monkeypatch, "train", at / "ball", at / "f", *TRAINING, *out) == 0
    return at


@pytest.fixture
def home(ball, monkeypatch):
    """The cache folder that the training used."""
    monkeypatch.setenv("HYBRID_HOME", str(ball / "home"))


def pixels(path) -> np.ndarray:
    return np.asarray(Image.open(path), dtype=np.float64) / 255


def test_training_says_what_it_reads_and_how_good_it_is(ball, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("HYBRID_HOME", str(tmp_path / "home"))
    row = json.loads((ball / "t.json").read_text())
    assert row["scene"] == "ball"
    assert row["layers"][-1]["psnr"] > 14
    few = ["--iterations", 5, "--gaussians", 200, "--degree", 0, "--layers", 1, "--motion", "d-gs"]
    assert run(monkeypatch, "train", ball / "ball", tmp_path / "f", *few) == 0
    shown = capsys.readouterr().out.splitlines()
    assert "ball: 8 frames to train on and 3 held out, layout of NeRF-synthetic or D-NeRF" in shown[0]
    assert shown[0].endswith("; a learned field deforms the Gaussians (d-gs)")


def test_a_held_out_view_is_rendered_at_its_time(ball, home, monkeypatch, tmp_path):
    out = tmp_path / "a.png"
    options = ["--forest", ball / "f", "--view", 2, "-o", out, "--json", tmp_path / "a.json"]
    assert run(monkeypatch, "render", ball / "ball", *options) == 0
    facts = json.loads((tmp_path / "a.json").read_text())
    assert (facts["scene"], facts["width"], facts["height"], facts["time"]) == ("ball", 48, 32, 1.0)
    assert facts["milliseconds"]["total"] > 0
    truth = pixels(ball / "ball/test/r_002.png")
    over_white = truth[..., :3] * truth[..., 3:] + 1 - truth[..., 3:]
    assert np.mean((pixels(out) - over_white) ** 2) < 0.04
    # Another time is another frame, if only by less than a step of 8 bits.
    red = []
    for time in (0, 1):
        exr = tmp_path / f"{time}.exr"
        assert run(monkeypatch, "render", ball / "ball", *options[:4], "--time", time, "-o", exr) == 0
        red.append(read_channels(exr)["R"])
    assert not np.array_equal(*red)


def test_the_newest_forest_of_the_frames_is_taken(ball, home, monkeypatch, tmp_path):
    assert run(monkeypatch, "render", ball / "ball", "-o", tmp_path / "a.png") == 0
    assert run(monkeypatch, "render", ball / "ball", "--forest", ball / "f", "-o", tmp_path / "b.png") == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_foveated_frame_has_less_detail_away_from_the_gaze(ball, home, monkeypatch, tmp_path):
    display = tmp_path / "display.json"
    display.write_text(json.dumps({"width": 48, "height": 32, "fov": 5}))
    options = ["--gaze", -12, 0.5, "--display", display, "--acuity-model", "geisler-perry"]
    options += ["--detail", tmp_path / "d.png", "-o", tmp_path / "a.exr"]
    assert run(monkeypatch, "render", ball / "ball", *options) == 0
    channels = read_channels(tmp_path / "a.exr")
    assert {"R", "G", "B", "splat.R", "eccentricity.V", "level.V", "rate.V"} <= channels.keys()
    assert 40 < channels["eccentricity.V"].min() < channels["eccentricity.V"].max() < 75
    assert channels["level.V"].max() < 2
    assert not np.array_equal(channels["R"], channels["splat.R"])
    assert (tmp_path / "d.png").is_file()


def test_cameras_sizes_and_eyes_are_those_asked_for(ball, home, monkeypatch, tmp_path):
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(camera_to_json(posed.camera(3, 40, 30))))
    options = ["--camera", camera, "--time", 0.5, "--eyes", 0.2, "--size", 60, 30, "-o", tmp_path / "a.png"]
    assert run(monkeypatch, "render", ball / "ball", *options) == 0
    left, right = (pixels(tmp_path / f"a-{eye}.png") for eye in ("left", "right"))
    assert left.shape == right.shape == (30, 60, 3)
    assert not np.array_equal(left, right)


def test_a_video_passes_all_held_out_views(ball, home, monkeypatch, tmp_path):
    av = pytest.importorskip("av")
    out = tmp_path / "a.mp4"
    trace = tmp_path / "gaze.csv"
    trace.write_text("seconds,x,y\n0,0.2,0.5\n1,0.8,0.5\n")
    options = ["--fps", 4, "--gaze-trace", trace, "-o", out, "--json", tmp_path / "a.json"]
    assert run(monkeypatch, "render", ball / "ball", *options) == 0
    with av.open(str(out)) as video:
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(frames) == len(json.loads((tmp_path / "a.json").read_text())["frames"]) == 4
    assert frames[0].shape == (32, 48, 3)
    for frame, number in ((frames[0], 0), (frames[-1], 2)):
        assert run(monkeypatch, "render", ball / "ball", "--view", number, "-o", tmp_path / "v.png") == 0
        # Of the video's gaze, and through its compression.
        assert np.abs(frame / 255 - pixels(tmp_path / "v.png")).mean() < 0.05
    assert run(monkeypatch, "render", ball / "ball", "--fps", 1, "-o", tmp_path / "b.mp4") == 0


MISTAKES = {
    "a disc": (["--fov-a", "10"], "--fov-a: requires a scene to path-trace"),
    "samples": (["--spp", "4"], "--spp: requires a scene"),
    "a fovea": (["--fovea", "raw"], "--fovea: requires a scene"),
    "a target": (["--target-ms", "9"], "--target-ms: requires a scene"),
    "thin glass": (["--thin-glass"], "--thin-glass: requires a scene"),
    "sensor": (["--sensor", "door"], "--sensor: requires a scene"),
    "a view that is not there": (["--view", "3"], "--view 3: .* has views 0 to 2"),
    "layers that are not there": (["--layers", "1", "9"], "layers 1 9: this forest has layers 1 to 2"),
    "a video of one view": (["--view", "1", "-o", "{tmp}/a.mp4"], "--view, --camera, --time"),
    "an unknown kind of file": (["-o", "{tmp}/a.jpg"], "a.jpg: must end in .exr or .png"),
    "a size of zero": (["--size", "0", "9"], "--size 0 9"),
    "a video of odd width": (["-o", "{tmp}/a.mp4", "--size", "9", "8"], "must be even"),
}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        pytest.param(
            *case,
            marks=extreme(
                f"frames of others, rendered with {name}", given=" ".join(case[0]), expected="refused by name"
            ),
        )
        for name, case in MISTAKES.items()
    ],
)
def test_what_needs_a_scene_or_is_not_there_is_refused(
    ball, home, monkeypatch, tmp_path, capsys, options, message, got
):
    output = [] if "-o" in options else ["-o", str(tmp_path / "a.png")]
    given = [option.format(tmp=tmp_path) for option in options]
    assert run(monkeypatch, "render", ball / "ball", *output, *given) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert re.search(message, said)
    assert not list(tmp_path.iterdir())
    got("refused")


def test_a_forest_of_other_frames_is_refused(ball, home, monkeypatch, tmp_path, capsys):
    other = posed.write_synthetic(tmp_path / "other", training=2, held_out=1)
    assert run(monkeypatch, "render", other, "--forest", ball / "f", "-o", tmp_path / "a.png") == 2
    assert "belongs to scene ball" in capsys.readouterr().err
    assert run(monkeypatch, "render", other, "-o", tmp_path / "a.png") == 2
    assert "no forest was trained on these frames yet" in capsys.readouterr().err


def test_views_of_a_scene_are_refused(monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "render", "cornell", "--view", 1, "-o", tmp_path / "a.png") == 2
    assert "--view 1: only for a folder of images" in capsys.readouterr().err
