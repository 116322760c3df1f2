"""The whole workflow in small: everything is written, and what cannot be measured is left out."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from compose.image.colour import bytes_from_radiance
from hybrid.frame.settings import FrameSettings
from hybrid.measure.metrics import registration
from hybrid.output.images import read_exr
from hybrid.quickstart import quickstart as module
from hybrid.quickstart.quickstart import quickstart
from hybrid.store.cache import newest_forest
from hybrid.training import quick
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.scene.scene import load_scene
from splat.training.trainer import TrainingSettings

pytestmark = pytest.mark.usefixtures("backend", "own_home")
SIDE = 128


@pytest.fixture
def tiny(monkeypatch):
    """Settings that take seconds."""
    capture = CaptureSettings(views=4, held_out=1, width=32, height=32, spp=2, held_out_spp=4)
    monkeypatch.setattr(quick, "QUICK_CAPTURE", capture)
    monkeypatch.setattr(quick, "QUICK_TRAINING", TrainingSettings(iterations=20, gaussians=500, layers=2))
    for name, value in (("SIZE", SIDE), ("_REFERENCE_SPP", 4), ("_REPEATS", 3), ("_WARM_UP", 1)):
        monkeypatch.setattr(module, name, value)


@pytest.mark.parametrize(("name", "textured"), [("room", True), ("cornell", False)])
def test_everything_is_written(name, textured, tiny, monkeypatch, tmp_path):
    if not textured:
        monkeypatch.setattr(registration, "_TEXTURE", 10.0)
    scene, settings = load_scene(name), FrameSettings(fov_a=30, fov_b=20, spp=2)
    result = quickstart(scene, tmp_path, settings, 3)
    assert {path.name for path in tmp_path.iterdir()} == {
        "frames-3", "quick-3.safetensors", "index.html",
        "hybrid.exr", "hybrid.png", "reference.png", "splat.png", "weights.png",
    }  # fmt: skip
    composite = np.stack([read_exr(tmp_path / "hybrid.exr")[f"composite.{c}"] for c in "RGB"], axis=2)
    shown = {path.stem: np.asarray(Image.open(path)) for path in tmp_path.glob("*.png")}
    assert {image.shape for image in shown.values()} == {(SIDE, SIDE, 3)}
    np.testing.assert_array_equal(shown["hybrid"], bytes_from_radiance(composite))
    assert not np.array_equal(shown["reference"], shown["splat"])
    assert newest_forest(scene).name == "quick-3.safetensors"
    check_result(result, name)
    assert ("registration_px" in result) == textured
    page = (tmp_path / "index.html").read_text()
    assert page.count("data:image/png;base64,") == 4
    assert f"{result['hybrid']['psnr']:.2f} dB" in page


def check_result(result, name: str) -> None:
    facts = {"scene": name, "width": SIDE, "height": SIDE, "spp": 2, "fov_a": 30, "fov_b": 20}
    assert {key: result[key] for key in facts} == facts
    assert set(result["seconds"]) == {"capture", "train", "render", "total"}
    assert result["seconds"]["total"] > result["seconds"]["render"] > 0
    assert [row["layer"] for row in result["layers"]] == [1, 2]
    assert result["splat"] == {metric: result["layers"][-1][metric] for metric in ("psnr", "ssim")}
    assert result["hybrid"]["psnr"] > 10
    for times in ("hybrid_ms", "path_traced_ms", "disc_ms"):
        assert 0 < result[times]["p50"] <= result[times]["p95"]
    assert result["ceiling"] > 0
    assert 0 < result["covered"] < 1
    assert result["reference_spp"] == 4
    assert result["gaussians"] == result["layers"][-1]["nodes"]
    assert result["machine"]["cores"] > 0
