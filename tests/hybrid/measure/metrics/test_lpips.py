"""LPIPS: with a tiny network by hand, and with the authors' weights if they are installed."""

from __future__ import annotations

import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from hybrid.measure import perceptual_metrics as module
from hybrid.measure.perceptual_metrics import lpips
from tests import small


@pytest.fixture
def fresh_weights():
    """Weights are read anew, before and after."""
    module._weights.cache_clear()
    yield
    module._weights.cache_clear()


@pytest.fixture
def one_layer(tmp_path, monkeypatch, fresh_weights):
    """A network whose first layer has the features (red, 1) and whose other layers say nothing."""
    kernels = [(11, 3, 2), (5, 2, 1), (3, 1, 1), (3, 1, 1), (3, 1, 1)]
    content: dict[str, dict] = {"AlexNet_0": {}}
    for number, (side, inputs, outputs) in enumerate(kernels):
        kernel = np.zeros((side, side, inputs, outputs), np.float32)
        bias, head = np.zeros(outputs, np.float32), np.ones((1, 1, outputs, 1), np.float32)
        if number == 0:
            # Centre of the window, red only.
            kernel[5, 5, 0, 0], bias[1] = 1, 1
            head[0, 0, :, 0] = 3, 2
        content["AlexNet_0"][f"Conv_{number}"] = {"kernel": kernel, "bias": bias}
        content[f"NetLinLayer_{number}"] = {"Conv_0": {"kernel": head}}
    file = tmp_path / "alexnet.ckpt"
    file.write_bytes(pickle.dumps(content))

    class InPackage(type(Path())):  # type: ignore[misc]
        def locate(self) -> Path:
            return file

    package = SimpleNamespace(files=[InPackage("readme.txt"), InPackage("weights/alexnet.ckpt")])
    monkeypatch.setattr(module, "distribution", lambda name: package)


def flat(value: float, size: int = 40) -> np.ndarray:
    return np.full((size, size, 3), value, dtype=np.float32)


def test_a_network_small_enough_for_hand_computation(one_layer):
    """White has the feature (1 + 0.030) / 0.458 = 2.24891, black 0 after the rectifier; the other one is 1.

    Unit vectors are (0.913738, 0.406303) and (0, 1): 3 * 0.913738^2 + 2 * 0.593697^2 = 3.209705.
    """
    assert lpips(flat(1.0), flat(0.0)) == pytest.approx(3.209705, abs=1e-5)
    assert lpips(flat(5.0), flat(-1.0)) == lpips(flat(1.0), flat(0.0))
    assert lpips(flat(0.3), flat(0.3)) == 0


def test_small_images_have_none(one_layer):
    assert lpips(flat(1.0, 32), flat(0.0, 32)) is not None
    assert lpips(flat(1.0, 31), flat(0.0, 31)) is None
    assert lpips(flat(1.0, 64)[:16], flat(0.0, 64)[:16]) is None


def test_without_weights_there_is_no_value(monkeypatch, fresh_weights):
    def absent(name: str) -> None:
        raise module.PackageNotFoundError(name)

    monkeypatch.setattr(module, "distribution", absent)
    assert lpips(flat(1.0), flat(1.0)) is None


def test_the_authors_weights_see_more_of_more_noise():
    image = gaussian_filter(small.rng().uniform(0, 1, (96, 96, 3)), (3, 3, 0)).astype(np.float32)
    if lpips(image, image) is None:
        pytest.skip("the weights of LPIPS are not installed")
    noise = small.rng(1).normal(0, 0.1, image.shape).astype(np.float32)
    distances = [lpips(image + scale * noise, image) for scale in (0, 0.1, 0.5, 2)]
    assert distances[0] == 0
    assert distances == sorted(distances)
    assert 0.1 < distances[-1] < 2
