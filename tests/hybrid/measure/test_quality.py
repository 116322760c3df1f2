"""The harness checked against itself: what is equal is equal, and every metric sees a defect where it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from compose.base.errors import UserError
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from hybrid.measure.metrics.lpips import lpips
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.metrics.ssim import ssim
from hybrid.measure.quality import METRICS, Viewer, acuity_weight, checked_pair, measured
from hybrid.measure.regions import REGIONS, regions
from tests import small

SIZE = 128
GAZE = Gaze(0.4, 0.55)
VIEWER = Viewer(Display(SIZE, SIZE, 12.0), GAZE)
FOVEATION = Foveation(GAZE, 30.0, 20.0)


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    """A picture with edges and texture."""
    noise = small.rng().normal(size=(SIZE, SIZE, 3))
    blocks = np.kron(small.rng().uniform(0.1, 0.9, (8, 8, 3)), np.ones((16, 16, 1)))
    picture = blocks * (1 + 0.15 * gaussian_filter(noise, (1, 1, 0)) / 0.28)
    return np.clip(picture, 0.01, 1).astype(np.float32)


def table(image: np.ndarray, reference: np.ndarray) -> dict[tuple[str, str], float]:
    rows = measured(image, reference, regions(FOVEATION, reference), VIEWER)
    return {(str(row["region"]), str(row["metric"])): float(row["value"]) for row in rows}


def test_a_frame_against_itself_is_perfect(scene):
    found = table(scene, scene)
    perfect = {"psnr": 120, "ssim": 1, "fssim": 1, "flip": 0, "hdr-flip": 0, "lpips": 0, "jod": 10}
    assert {region for region, _ in found} == set(REGIONS)
    assert {"psnr", "ssim", "fssim"} <= {metric for _, metric in found}
    for (region, metric), value in found.items():
        assert value == pytest.approx(perfect[metric], abs=1e-6), (region, metric)


def test_noise_of_a_known_size_gives_its_psnr(scene):
    """PSNR of noise of deviation s in sRGB is -20 log10 s."""
    encoded = 0.5 + small.rng().normal(0, 0.02, (SIZE, SIZE, 3))
    linear = ((encoded + 0.055) / 1.055) ** 2.4
    middle = np.full_like(linear, ((0.5 + 0.055) / 1.055) ** 2.4)
    found = psnr(linear.astype(np.float32), middle.astype(np.float32))
    assert found == pytest.approx(-20 * np.log10(0.02), abs=0.1)


def test_a_shift_of_a_flat_picture_gives_the_ssim_of_the_formula():
    """Without any variance SSIM is its luminance term, (2 ab + C1) / (a^2 + b^2 + C1)."""
    levels = np.array([0.4, 0.7])
    flat = [np.full((32, 32, 3), ((v + 0.055) / 1.055) ** 2.4, dtype=np.float32) for v in levels]
    a, b = levels
    assert ssim(*flat) == pytest.approx((2 * a * b + 1e-4) / (a * a + b * b + 1e-4), abs=1e-5)


@pytest.mark.parametrize("defect", ["noise", "blur"])
def test_each_metric_tells_where_a_defect_is(scene, defect):
    """In the fovea, then in the periphery: the one region suffers, the other stays perfect."""
    if defect == "noise":
        bad = scene * small.rng().uniform(0.5, 1.5, scene.shape).astype(np.float32)
    else:
        bad = gaussian_filter(scene, (2, 2, 0))
    parts = regions(FOVEATION, scene)
    found = {name: table(parts[name].alone(bad, scene), scene) for name in ("foveal", "peripheral")}
    perfect = table(scene, scene)
    for metric, more_is_better in METRICS.items():
        sign = 1 if more_is_better else -1
        for place, other in (("foveal", "peripheral"), ("peripheral", "foveal")):
            if (place, metric) not in perfect:
                continue
            assert sign * found[place][place, metric] < sign * perfect[place, metric] - 1e-3
            if ("whole", metric) in perfect:
                assert sign * found[place]["whole", metric] < sign * perfect["whole", metric] - 1e-3
            assert found[other][place, metric] == pytest.approx(perfect[place, metric], abs=1e-6)


def test_less_of_a_defect_is_better_in_every_metric(scene):
    worse, better = (
        table(scene * small.rng().uniform(1 - s, 1 + s, scene.shape).astype(np.float32), scene)
        for s in (0.5, 0.1)
    )
    for key in worse:
        sign = 1 if METRICS[key[1]] else -1
        assert sign * worse[key] < sign * better[key], key


def test_what_the_eye_resolves_weighs_most_at_the_gaze(scene):
    weight = acuity_weight(VIEWER, (SIZE, SIZE))
    x, y = GAZE.pixel(SIZE, SIZE)
    assert weight[int(y), int(x)] == weight.max() == pytest.approx(1, abs=0.05)
    assert weight[0, -1] < 0.5


def test_pictures_that_cannot_be_compared_are_named(scene):
    with pytest.raises(UserError, match="peer is 128 x 127 pixels, its reference 128 x 128"):
        checked_pair(scene[1:], scene, "peer")
    broken = scene.copy()
    broken[3, 4, 1] = np.inf
    with pytest.raises(UserError, match="peer has 1 pixels that are not finite"):
        checked_pair(broken, scene, "peer")
    with pytest.raises(UserError, match="the reference of peer has 1 pixels"):
        checked_pair(scene, broken, "peer")


def test_regions_that_are_empty_or_unseen_are_named(scene):
    with pytest.raises(UserError, match=r"gaze 1.2 0.5: lies outside the frame"):
        regions(Foveation(Gaze(1.2, 0.5)), scene)
    with pytest.raises(UserError, match="the foveal region of this frame is empty"):
        regions(Foveation(GAZE, 0.0, 0.0), scene)
    assert set(regions(Foveation(GAZE, 500.0, 20.0), scene)) == {"whole", "foveal", "salient"}
    parts = regions(FOVEATION, scene)
    assert (parts["foveal"].mask ^ parts["peripheral"].mask).all()
    assert (parts["seam"].mask <= parts["foveal"].mask).all()
    assert 0.1 < parts["salient"].mask.mean() < 0.3


def test_weights_of_lpips_are_arrays_only():
    import io
    import pickle

    from hybrid.measure.metrics.lpips import _ArraysOnly

    with pytest.raises(pickle.UnpicklingError, match="no array"):
        _ArraysOnly(io.BytesIO(pickle.dumps(print))).load()
    held = {"a": np.arange(3.0)}
    np.testing.assert_array_equal(_ArraysOnly(io.BytesIO(pickle.dumps(held))).load()["a"], held["a"])
    if lpips(np.zeros((64, 64, 3), np.float32), np.zeros((64, 64, 3), np.float32)) is None:
        pytest.skip("the weights of LPIPS are not installed")
    assert lpips(np.zeros((16, 64, 3), np.float32), np.zeros((16, 64, 3), np.float32)) is None
