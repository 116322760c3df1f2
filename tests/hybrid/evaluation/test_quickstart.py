"""The quickstart: its job, its comparison with full path tracing."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from PIL import Image

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from compose.image.colour import bytes_from_radiance
from hybrid.base.cache_folder import newest_forest
from hybrid.evaluation import quickstart as module
from hybrid.evaluation.baselines_traced import FullTrace
from hybrid.evaluation.quickstart import compare, quickstart
from hybrid.measure import image_metrics as registration
from hybrid.preparation.scene_plan import as_planned
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.image_files import read_exr
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.region.neighbourhood import unseen_views
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from tests.extremes import extreme
from tests.hybrid.preparation.tiny import make_tiny

pytestmark = pytest.mark.usefixtures("backend", "own_home")
SIDE = 96


WRITTEN = {"index.html", "hybrid.exr", "hybrid.png", "reference.png", "splat.png", "weights.png"}


@pytest.fixture
def tiny(monkeypatch):
    """Settings that take seconds."""
    make_tiny(monkeypatch.setattr)
    for name, value in (("SIZE", SIDE), ("_REFERENCE_SPP", 4), ("_REPEATS", 3), ("_WARM_UP", 1)):
        monkeypatch.setattr(module, name, value)


def test_from_nothing_to_images_and_a_page(tiny, tmp_path):
    scene, folder = as_planned(load_scene("room")), tmp_path / "out"
    result = quickstart(scene, folder, FrameSettings(fov_a=30, fov_b=20, spp=2), 3)
    assert {path.name for path in folder.iterdir()} == WRITTEN | {"prepared-3"}
    composite = np.stack([read_exr(folder / "hybrid.exr")[f"composite.{c}"] for c in "RGB"], axis=2)
    shown = {path.stem: np.asarray(Image.open(path)) for path in folder.glob("*.png")}
    assert {image.shape for image in shown.values()} == {(SIDE, SIDE, 3)}
    np.testing.assert_array_equal(shown["hybrid"], bytes_from_radiance(composite))
    assert not np.array_equal(shown["reference"], shown["splat"])
    assert newest_forest(scene).name == "prepared-3.safetensors"
    check_result(result)
    assert result["registration_px"] > 0
    page = (folder / "index.html").read_text()
    assert page.count("data:image/png;base64,") == 4
    assert f"{result['hybrid']['psnr']:.2f} dB" in page


@extreme(
    "what quickstart is judged on",
    given="a scene whose own camera training has always seen",
    expected="three views that nothing was fitted to, in quality and in times",
)
def test_nothing_was_fitted_to_the_views_that_are_judged(tiny, made, monkeypatch, tmp_path, got):
    """What cannot be measured is left out: an image without texture shows no offset."""
    monkeypatch.setattr(registration, "_TEXTURE", 10.0)
    ready = load_forest(made / "box.forest"), read_frame_set(made / "frames")
    monkeypatch.setattr(module, "make_quick_forest", lambda scene, folder, seed, bars: ready)
    given = {}
    for name in ("judged_views", "compare"):
        make = getattr(module, name)
        monkeypatch.setattr(
            module,
            name,
            lambda renderer, views, *rest, name=name, make=make: (
                given.update({name: [view.key for view in views]}),
                make(renderer, views, *rest),
            )[1],
        )
    (tmp_path / "out").mkdir()
    scene = as_planned(load_scene("cornell"))
    result = quickstart(scene, tmp_path / "out", FrameSettings(spp=1), 0)
    unseen = [view.key for view in unseen_views(scene, 3, SIDE, SIDE)]
    assert given == {"judged_views": unseen, "compare": unseen}
    assert scene.camera.resized(SIDE, SIDE).key not in unseen
    assert got(result["views"]) == 3
    assert "registration_px" not in result
    assert {path.name for path in (tmp_path / "out").iterdir()} == WRITTEN
    assert scene.camera.position.tolist() != unseen_views(scene, 1, SIDE, SIDE)[0].camera.position.tolist()


def check_result(result: dict[str, Any]) -> None:
    facts = {"scene": "room", "width": SIDE, "height": SIDE, "spp": 2, "fov_a": 30, "fov_b": 20}
    assert {key: result[key] for key in facts} == facts
    assert set(result["seconds"]) == {"prepare", "render", "total"}
    assert result["seconds"]["total"] > result["seconds"]["render"] > 0
    assert [row["layer"] for row in result["layers"]] == [1, 2]
    assert result["splat"] == {metric: result["layers"][-1][metric] for metric in ("psnr", "ssim")}
    assert result["hybrid"]["psnr"] > 10
    for times in ("hybrid_ms", "path_traced_ms", "disc_ms"):
        assert 0 < result[times]["p50"] <= result[times]["p95"]
        low, high = result[f"{times}_range"]
        assert 0 < low <= high
    assert result["views"] == 3
    for name in ("hybrid", "splats_alone"):
        for metric in ("psnr", "ssim"):
            low, high = result[f"{name}_range"][metric]
            assert low < result[name][metric] < high
    assert result["ceiling"] > 0
    assert 0 < result["covered"] < 1
    assert result["reference_spp"] == 4
    assert result["gaussians"] == result["layers"][-1]["nodes"]
    assert result["machine"]["cores"] > 0


def ignore(done: int, total: int) -> None:
    """No progress."""


def test_each_frame_has_a_camera_of_its_own(renderer, monkeypatch):
    asked = []
    for name in ("frame", "disc_alone"):
        make = getattr(renderer, name)
        monkeypatch.setattr(
            renderer,
            name,
            lambda settings, seed, make=make: (asked.append(settings.camera.key), make(settings, seed)),
        )
    trace = FullTrace.render
    monkeypatch.setattr(
        FullTrace,
        "render",
        lambda self, view, *rest: (asked.append(view.camera.key), trace(self, view, *rest)),
    )
    settings = FrameSettings(fov_a=60, fov_b=40, spp=1)
    row = compare(renderer, [View(renderer.scene.camera.resized(48, 32))], settings, 3, 1, ignore)
    assert len(asked) == len(set(asked)) == 3 * (3 + 1)
    assert row["covered"] == pytest.approx(0.69, abs=0.01)


@pytest.mark.parametrize("mode", list(FoveaMode))
def test_the_full_frame_is_denoised_where_the_disc_is(renderer, monkeypatch, mode):
    made = []

    def recorded(tracer, spp, denoised):
        made.append((spp, denoised))
        return FullTrace(tracer, spp, denoised)

    monkeypatch.setattr(module, "FullTrace", recorded)
    camera = renderer.scene.camera.resized(32, 32)
    compare(renderer, [View(camera)], FrameSettings(fovea=mode, spp=2, fov_a=30, fov_b=10), 3, 1, ignore)
    assert made == [(2, mode is not FoveaMode.RAW)]


def test_times_of_methods_are_told_apart():
    """Sleeping takes at least as long as asked."""
    slow, quick = lambda gaze, seed: time.sleep(0.02), lambda gaze, seed: None
    times = [[module._timed(method, Gaze(), 0)["total"] for _ in range(3)] for method in (slow, quick)]
    assert min(times[0]) >= 20 > min(times[1])


def test_ratios_are_those_of_the_medians(renderer, monkeypatch):
    """Path tracing takes 30 ms, hybrid frames 10, their discs 6."""
    times = [[10.0, 9, 11], [30.0, 90, 3], [6.0, 6, 6]]
    found = [[{"total": frame} for frame in frames] for frames in times]
    monkeypatch.setattr(module, "interleaved_passes", lambda methods, *_: found)
    row = compare(renderer, [View(renderer.scene.camera)], FrameSettings(), 3, 1, ignore)
    assert (row["ratio"], row["ceiling"]) == (3.0, 5.0)
    assert row["path_traced_ms"]["p50"] == 30
