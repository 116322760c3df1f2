"""Denoising: noise goes, edges and brightness stay."""

from __future__ import annotations

import mitsuba as mi
import mitsuba_oidn
import numpy as np
import pytest

import pathtrace.trace.traced_images as module
from pathtrace.trace.traced_images import denoise, denoise_coarsely
from tests import small
from tests.extremes import extreme

pytestmark = pytest.mark.usefixtures("backend")
SIZE = 64


@pytest.fixture(scope="module")
def images() -> dict[str, np.ndarray]:
    """A tiled wall under uneven light: truth, the same with noise of 70 %, albedo and normal."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    tile = (np.floor(x * 8) + np.floor(y * 8))[..., None] % 2
    albedo = np.where(tile, [0.9, 0.6, 0.3], [0.2, 0.3, 0.4]).astype(np.float32)
    truth = (albedo * (1 + x + 0.5 * np.sin(6 * y))[..., None]).astype(np.float32)
    noisy = (truth * small.rng().gamma(2, 0.5, truth.shape)).astype(np.float32)
    normal = np.broadcast_to([0, 0, 1], truth.shape).astype(np.float32)
    return {"truth": truth, "noisy": noisy, "albedo": albedo, "normal": normal}


def coarsely(*images: np.ndarray) -> np.ndarray:
    """`denoise_coarsely` of arrays."""
    return np.array(denoise_coarsely(*tensors(*images)))


def tensors(*images: np.ndarray) -> list[mi.TensorXf]:
    return [mi.TensorXf(np.ascontiguousarray(image, dtype=np.float32)) for image in images]


def error(image: np.ndarray, truth: np.ndarray) -> float:
    return float(np.mean((image - truth) ** 2))


def cleaned(images: dict[str, np.ndarray], clean=denoise, **options) -> np.ndarray:
    return clean(images["noisy"], images["albedo"], images["normal"], **options)


@pytest.mark.parametrize("clean", [denoise, coarsely])
def test_noise_is_removed_without_a_change_in_brightness(images, clean):
    result = cleaned(images, clean)
    assert result.dtype == np.float32
    # Measured: 27 times less.
    assert error(result, images["truth"]) < error(images["noisy"], images["truth"]) / 15
    assert result.mean() == pytest.approx(images["truth"].mean(), rel=0.05)


@pytest.mark.parametrize("quick", [False, True])
def test_tensors_stay_tensors_and_are_denoised_as_arrays_are(images, quick):
    given = tensors(images["noisy"], images["albedo"], images["normal"])
    result = denoise(*given, quick=quick)
    assert isinstance(result, mi.TensorXf)
    np.testing.assert_array_equal(np.array(result), cleaned(images, quick=quick))
    np.testing.assert_array_equal(np.array(given[0]), images["noisy"])


def test_albedo_preserves_edges(images):
    unguided = denoise(images["noisy"], np.ones_like(images["albedo"]), images["normal"])
    # Measured: 4 times less.
    assert error(cleaned(images), images["truth"]) < error(unguided, images["truth"]) / 2


def test_the_quick_network_is_used_on_request_only(images, monkeypatch):
    used = []
    oidn = mitsuba_oidn.denoise
    monkeypatch.setattr(
        mitsuba_oidn,
        "denoise",
        lambda *args, **options: used.append(options["quality"]) or oidn(*args, **options),
    )
    best, quick = cleaned(images), cleaned(images, quick=True)
    cleaned(images, coarsely)
    assert used == [mitsuba_oidn.Quality.High, mitsuba_oidn.Quality.Fast, mitsuba_oidn.Quality.Fast]
    assert not np.array_equal(best, quick)


def test_radiance_is_unbounded(images):
    bright = denoise(1000 * images["noisy"], images["albedo"], images["normal"])
    np.testing.assert_allclose(bright / 1000, cleaned(images), rtol=0.01, atol=0.01)


def test_albedo_is_clipped_and_arrays_need_not_be_contiguous(images):
    flipped = denoise(
        images["noisy"][:, ::-1].astype(np.float64),
        np.where(images["albedo"] == np.float32(0.9), 7.0, images["albedo"])[:, ::-1],
        images["normal"][:, ::-1],
    )
    saturated = np.where(images["albedo"] == np.float32(0.9), np.float32(1), images["albedo"])
    expected = denoise(
        np.ascontiguousarray(images["noisy"][:, ::-1]),
        np.ascontiguousarray(saturated[:, ::-1]),
        images["normal"],
    )
    np.testing.assert_array_equal(flipped, expected)


@pytest.fixture
def resampling_alone(monkeypatch):
    """Replaces the denoiser, so that only the change of resolution is left; records its quality."""
    asked = []

    def identity(radiance, albedo, normal, quick):
        asked.append((radiance.shape, albedo.shape, normal.shape, quick))
        return radiance

    monkeypatch.setattr(module, "_denoised", identity)
    return asked


@pytest.mark.parametrize("size", [(8, 12), (7, 11)])
def test_a_linear_ramp_survives_the_lower_resolution(resampling_alone, size):
    """Means of 2 x 2 pixels and linear interpolation reproduce it except at the border."""
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(np.float32)
    ramp = np.stack([x, y, 3 * x - 2 * y + 50], axis=-1)
    grey = np.full_like(ramp, 0.4)
    result = coarsely(ramp, grey, grey)
    half = (-(-size[0] // 2), -(-size[1] // 2), 3)
    assert resampling_alone == [(half, half, half, True)]
    assert result.shape == ramp.shape
    np.testing.assert_allclose(result[1:-2, 1:-2], ramp[1:-2, 1:-2], rtol=1e-5, atol=1e-5)
    # In the corner, the mean of the first four pixels is repeated.
    np.testing.assert_allclose(result[0, 0], [0.5, 0.5, 50.5], rtol=1e-5)


def test_an_even_image_stays_even(resampling_alone):
    """Up to its border, also where an odd side leaves half a block."""
    even = np.full((7, 11, 3), 2.5, dtype=np.float32)
    np.testing.assert_allclose(coarsely(even, even, even), even, rtol=1e-5)


def test_the_albedos_detail_is_restored(resampling_alone):
    """Under even light, stripes of single pixels come back although half the resolution cannot show them."""
    albedo = np.zeros((8, 8, 3), dtype=np.float32)
    albedo[:, ::2] = 0.8
    result = coarsely((albedo + np.float32(0.1)) * 5, albedo, albedo)
    np.testing.assert_allclose(result[:, ::2], 4.5, rtol=1e-5)
    np.testing.assert_allclose(result[:, 1::2], 0.5, rtol=1e-5)


@extreme("denoising the dimmest light", given="radiance of 1e-38", expected="as of radiance 1, to 1e-4")
def test_dim_images_are_denoised_as_bright_ones(images, got):
    """Where all radiance is below 1e-8, OIDN alone returns some 1e-6 whatever it is given."""
    # Kernels, by which the coarse one halves, take less than 1e-38 for 0.
    for clean, least in ((denoise, 1e-38), (coarsely, 1e-30)):
        bright = cleaned(images, clean)
        for factor in (1e-6, 1e-9, 1e-20, least):
            dim = cleaned(images | {"noisy": images["noisy"] * np.float32(factor)}, clean)
            worst = float(np.abs(dim / factor - bright).max())
            assert worst < small.denoising_error()
        got(worst, ".1e")


@extreme("denoising no light", given="a black image", expected="black: OIDN alone shows up to 8e-4")
def test_black_stays_black(images, got):
    black = np.zeros_like(images["noisy"])
    for clean in (denoise, coarsely):
        assert got(cleaned(images | {"noisy": black}, clean).max(), "g") == 0


def test_what_is_not_finite_is_left_to_the_denoiser(images):
    broken = images["noisy"] * np.float32(1e-12)
    broken[3, 3] = np.nan
    assert cleaned(images | {"noisy": broken}).shape == broken.shape
