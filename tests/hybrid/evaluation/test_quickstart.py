"""The whole workflow in small: everything is written, and what cannot be measured is left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from PIL import Image

from compose.image.colour import bytes_from_radiance
from hybrid.base.cache_folder import newest_forest
from hybrid.evaluation import quickstart as module
from hybrid.evaluation.quickstart import quickstart
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
SIDE = 128


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
