"""`hybrid render`: one frame, or a video along a gaze trace."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from compose.camera.camera import eyes
from compose.camera.coordinate_systems import camera_from_json
from compose.eye.gaze import Gaze, GazeTrace
from hybrid.cli.render import render as command
from hybrid.preparation.scene_plan import as_planned
from hybrid.render import video
from hybrid.render.forest_attachments import attach_views
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import DEFAULTS, FrameSettings
from hybrid.render.image_files import read_exr
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest, save_forest
from tests.conftest import real_file
from tests.extremes import extreme
from tests.hybrid.command import TINY_CAPTURE, TINY_TRAINING, run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


@pytest.fixture
def render(made, monkeypatch):
    """Renders the Cornell box with options and returns the exit code."""
    common = [command.__name__, "cornell", "--forest", made / "box.forest"]
    return lambda *options: run(monkeypatch, *common, *options)


def test_both_kinds_of_image_are_written(render, tmp_path, capsys):
    common = ["--size", 60, 40, "--gaze", 0.3, 0.6]
    assert render(*common, "-o", tmp_path / "a.exr", "--json", tmp_path / "a.json") == 0
    assert f"{tmp_path / 'a.exr'}: 60 x 40, " in capsys.readouterr().out
    assert render(*common, "-o", tmp_path / "a.png", "--fovea", "raw") == 0
    aovs = read_exr(tmp_path / "a.exr")
    assert aovs["composite.R"].shape == (40, 60)
    assert np.isfinite(aovs["composite.R"]).all()
    wanted = {"fovea.R", "variance.G", "denoised.B", "fusion.traced.V", "fusion.denoised.V", "fusion.splat.V"}
    assert wanted <= set(aovs)
    assert Image.open(tmp_path / "a.png").size == (60, 40)


def test_the_frame_is_that_of_the_options(render, made, tmp_path):
    out, options = tmp_path / "a.json", ["--size", 40, 30, "--gaze", 0.3, 0.6, "--fov-a", 30, "--fov-b", 10]
    options += ["--spp", 3, "--fovea", "denoised", "--acuity-model", "fov-gs", "--layers", 1, 2, "--seed", 5]
    assert render(*options, "--display", "hmd", "-o", tmp_path / "a.exr", "--json", out) == 0
    scene = as_planned(load_scene("cornell"))
    settings = FrameSettings((0.3, 0.6), 30, 10, 3, "denoised", "fov-gs", (1, 2), display="hmd")
    settings = replace(settings, camera=scene.camera.resized(40, 30))
    frame = Renderer(scene, load_forest(made / "box.forest")).frame(settings, 5)
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")["composite.G"], frame.composite[..., 1])
    row = json.loads(out.read_text())
    assert list(row.pop("milliseconds")) == list(frame.milliseconds)
    # A headset's 1440 pixels across 97 degrees: 2 * 720 / tan(48.5 degrees) / 2 * pi / 180.
    assert row.pop("pixels_per_degree") == pytest.approx(11.12, abs=0.01)
    assert row == {
        "scene": "cornell",
        "width": 40,
        "height": 30,
        "spp": 3,
        "fov_a": 30,
        "fov_b": 10,
        "time": 0.0,
        "fovea": "denoised",
        "paths": "disc",
        "integrator": "cached",
        "unbiased": False,
        "acuity_model": "fov-gs",
        "level": None,
        "gaussians": None,
        "level_jod": None,
        "nodes_drawn": frame.nodes_drawn,
        "pixels_excluded": 0,
        "filled": 0.0,
    }


def test_both_eyes_are_written(render, made, tmp_path):
    """Each is the frame of a camera of its own; at no distance, both are the same one."""
    common = ["--size", 40, 30, "--seed", 5, "--json", tmp_path / "a.json"]
    assert render(*common, "--eyes", 0.4, "-o", tmp_path / "a.exr") == 0
    scene = as_planned(load_scene("cornell"))
    renderer = Renderer(scene, load_forest(made / "box.forest"))
    for name, camera in zip(("left", "right"), eyes(scene.camera.resized(40, 30), 0.4), strict=True):
        found = read_exr(tmp_path / f"a-{name}.exr")["composite.G"]
        expected = renderer.frame(replace(DEFAULTS, camera=camera), 5).composite[..., 1]
        np.testing.assert_array_equal(found, expected)
    assert set(json.loads((tmp_path / "a.json").read_text())) == {"left", "right"}
    assert render(*common, "--eyes", 0, "-o", tmp_path / "b.exr") == 0
    left, right = (read_exr(tmp_path / f"b-{name}.exr")["composite.G"] for name in ("left", "right"))
    np.testing.assert_array_equal(left, right)


def test_eyes_are_for_a_single_frame(render, trace, tmp_path, capsys):
    assert render("--eyes", 0.1, "--gaze-trace", trace, "-o", tmp_path / "a.mp4") == 2
    assert "--eyes: only for a single frame" in capsys.readouterr().err
    assert not list(tmp_path.glob("a*.mp4"))


def test_the_integrator_is_written_into_the_frame_and_its_facts(render, tmp_path):
    out = tmp_path / "a.json"
    found = {}
    for integrator in ("path", "cached"):
        options = ["--size", 40, 40, "--spp", 2, "--fovea", "raw", "--integrator", integrator]
        assert render(*options, "-o", tmp_path / f"{integrator}.exr", "--json", out) == 0
        row = json.loads(out.read_text())
        header = OpenEXR.File(str(tmp_path / f"{integrator}.exr")).header()
        unbiased = integrator == "path"
        assert (row["integrator"], row["unbiased"]) == (integrator, unbiased)
        assert (header["integrator"], header["unbiased"]) == (integrator, str(unbiased))
        found[integrator] = read_exr(tmp_path / f"{integrator}.exr")["path-traced.G"]
    assert (found["path"] != found["cached"]).any()


def test_without_options_the_scenes_own_view_is_rendered(render, tmp_path, monkeypatch):
    given, original = [], Renderer.frame

    def noting(self, settings, seed):
        given.append((settings, seed))
        return original(self, settings.with_radius(5.0), seed)

    monkeypatch.setattr(Renderer, "frame", noting)
    assert render("-o", tmp_path / "a.png") == 0
    ((settings, seed),) = given
    assert seed == 0
    assert settings == replace(DEFAULTS, camera=as_planned(load_scene("cornell")).camera)


def test_what_the_eye_resolves_is_shown(render, tmp_path):
    common = ["--size", 320, 200, "--fov-a", 9, "--fov-b", 6, "--display", "hmd", "--spp", 1]
    detail = ["--detail", tmp_path / "d.png"]
    assert render(*common, "--acuity-model", "fov-gs", "-o", tmp_path / "a.exr", *detail) == 0
    aovs = read_exr(tmp_path / "a.exr")
    assert aovs["level.V"].min() < 2
    assert aovs["rate.V"].max() >= 1
    picture = np.asarray(Image.open(tmp_path / "d.png"))
    assert picture.shape[0] > 200
    assert picture.shape[1] == 320
    # The coarsest layer alone is what `--layers 1 1` draws.
    assert render(*common, "--layers", 1, 1, "-o", tmp_path / "b.exr") == 0
    assert (read_exr(tmp_path / "b.exr")["level.V"] == 1).all()


def test_a_camera_may_come_from_a_file(render, made, tmp_path):
    document = json.loads((made / "frames" / "transforms.json").read_text())
    camera = {k: document[k] for k in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    camera["transform_matrix"] = document["frames"][2]["transform_matrix"]
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    none = ["--fov-a", 0, "--fov-b", 0, "--acuity-model", "none", "--camera", tmp_path / "camera.json"]
    assert render(*none, "-o", tmp_path / "a.exr") == 0
    settings = FrameSettings(fov_a=0, fov_b=0, acuity_model="none", camera=camera_from_json(camera))
    expected = Renderer(as_planned(load_scene("cornell")), load_forest(made / "box.forest")).frame(settings)
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")["R"], expected.composite[..., 0])
    assert render(*none, "--size", 48, 40, "-o", tmp_path / "a.png") == 0
    assert Image.open(tmp_path / "a.png").size == (48, 40)


@extreme(
    "a view that a forest was not prepared for",
    given="hybrid render with a forest whose only training view looks the other way",
    expected="the frame, and one line that says how much of it the forest does not know",
)
def test_a_view_that_the_forest_was_not_prepared_for_is_named(made, monkeypatch, tmp_path, capsys, got):
    camera = as_planned(load_scene("cornell")).camera.resized(40, 40)
    behind = replace(camera, world_to_camera=np.diag([-1.0, 1, -1, 1]) @ camera.world_to_camera)
    save_forest(tmp_path / "a.forest", attach_views(load_forest(made / "box.forest"), [behind]))
    given = ["--forest", tmp_path / "a.forest", "--size", 40, 40, "-o", tmp_path / "a.png"]
    assert run(monkeypatch, "render", "cornell", *given) == 0
    said = capsys.readouterr().out.splitlines()[-1]
    assert said.startswith("the forest was not prepared for ")
    got(said)


def test_without_a_name_the_newest_forest_of_the_scene_is_used(made, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("HYBRID_HOME", str(made / "home"))
    assert run(monkeypatch, "render", "cornell", "--size", 40, 40, "-o", tmp_path / "a.png") == 0
    assert "training one first" not in capsys.readouterr().err


@pytest.mark.parametrize(("name", "fovea"), [("staircase2", "raw"), ("veach-bidir", "fused")])
def test_scenes_in_the_wild_go_through_every_command(name, fovea, monkeypatch, tmp_path):
    scene = real_file(f"scenes/{name}/scene.xml")
    assert run(monkeypatch, "capture", scene, tmp_path / "frames", *TINY_CAPTURE) == 0
    assert run(monkeypatch, "train", tmp_path / "frames", tmp_path / "f", *TINY_TRAINING) == 0
    common = [scene, "--forest", tmp_path / "f", "--size", 64, 48]
    assert run(monkeypatch, "render", *common, "--fovea", fovea, "-o", tmp_path / "a.exr") == 0
    aovs = read_exr(tmp_path / "a.exr")
    assert all(np.isfinite(aovs[f"composite.{c}"]).all() for c in "RGB")
    assert aovs["composite.G"].mean() > 0.01
    assert run(monkeypatch, "export", tmp_path / "f", tmp_path / "a.ply") == 0


@pytest.fixture
def trace(tmp_path):
    file = tmp_path / "gaze.csv"
    GazeTrace((0.0, 0.1), (Gaze(0.25, 0.5), Gaze(0.75, 0.5))).save(file)
    return file


def test_a_gaze_trace_makes_a_video(render, trace, tmp_path, capsys):
    pytest.importorskip("av", reason="videos require PyAV")
    options = [
        "--gaze-trace",
        trace,
        "--size",
        32,
        32,
        "--spp",
        1,
        "--fovea",
        "raw",
        "-o",
        tmp_path / "a.mp4",
    ]
    assert render(*options, "--json", tmp_path / "a.json") == 0
    assert f"{tmp_path / 'a.mp4'}: 3 frames of 32 x 32" in capsys.readouterr().out
    row = json.loads((tmp_path / "a.json").read_text())
    assert (row["fps"], len(row["frames"]), row["fovea"], row["spp"]) == (30, 3, "raw", 1)
    assert (tmp_path / "a.mp4").stat().st_size > 0


def test_everything_that_a_video_depends_on_is_part_of_its_identity(render, trace, tmp_path, monkeypatch):
    pytest.importorskip("av", reason="videos require PyAV")
    given = []

    def noting(path, renderer, settings, trace, fps, seed, identity, progress):
        assert renderer.fovea_of(settings).disc.has_history
        given.append((fps, seed, json.dumps(identity, sort_keys=True)))
        return []

    monkeypatch.setattr(video, "render_video", noting)
    GazeTrace((0.0, 0.2), (Gaze(), Gaze())).save(tmp_path / "other.csv")
    common = ["--gaze-trace", trace, "--size", 32, 32, "-o", tmp_path / "a.mp4"]
    changes = [
        [],
        ["--fps", 8],
        ["--seed", 9],
        ["--spp", 1],
        ["--fov-a", 40],
        ["--fov-b", 1],
        ["--fovea", "raw"],
        ["--integrator", "path"],
        ["--layers", 1, 1],
        ["--acuity-model", "none"],
        ["--display", "hmd"],
        ["--size", 34, 32],
        ["--gaze-trace", tmp_path / "other.csv"],
    ]
    for options in changes:
        assert render(*common, *options) == 0
    assert given[0][:2] == (30, 0)
    assert given[1][0] == 8
    assert given[2][1] == 9
    assert len({identity for _, _, identity in given}) == len(changes)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["-o", "a.png"], "--output a.png of a gaze trace: must end in .mp4"),
        (["-o", "a.mp4", "--size", "33", "32"], "frame size 33 x 32"),
        (["-o", "a.mp4", "--detail", "d.png"], "--detail, --gaze-trace: only a single frame"),
        (["-o", "a.mp4", "--gaze", "0.5", "0.5"], "--gaze, --gaze-trace: the gaze can only come from one"),
    ],
)
def test_what_makes_no_video_is_refused(render, trace, monkeypatch, tmp_path, capsys, options, said):
    pytest.importorskip("av", reason="videos require PyAV")
    monkeypatch.chdir(tmp_path)
    assert render("--gaze-trace", trace, *options) == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["gaze.csv"]
