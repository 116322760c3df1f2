"""Traced images and their denoising: orientation and samples; noise goes, edges and brightness stay."""

from __future__ import annotations

import mitsuba as mi
import mitsuba_oidn
import numpy as np
import pytest

from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import box_positions, frame_positions
from pathtrace.trace.traced_images import (
    auxiliary_images,
    denoise,
    radiance_image,
    trace_image,
)
from pathtrace.trace.tracer import Tracer
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


def tensors(*images: np.ndarray) -> list[mi.TensorXf]:
    return [mi.TensorXf(np.ascontiguousarray(image, dtype=np.float32)) for image in images]


def error(image: np.ndarray, truth: np.ndarray) -> float:
    return float(np.mean((image - truth) ** 2))


def cleaned(images: dict[str, np.ndarray], **options) -> np.ndarray:
    return denoise(images["noisy"], images["albedo"], images["normal"], **options)


def test_noise_is_removed_without_a_change_in_brightness(images):
    result = cleaned(images)
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
    assert used == [mitsuba_oidn.Quality.High, mitsuba_oidn.Quality.Fast]
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


@extreme("denoising the dimmest light", given="radiance of 1e-38", expected="as of radiance 1, to 1e-4")
def test_dim_images_are_denoised_as_bright_ones(images, got):
    """Where all radiance is below 1e-8, OIDN alone returns some 1e-6 whatever it is given."""
    bright = cleaned(images)
    for factor in (1e-6, 1e-9, 1e-20, 1e-38):
        dim = cleaned(images | {"noisy": images["noisy"] * np.float32(factor)})
        worst = float(np.abs(dim / factor - bright).max())
        assert worst < small.denoising_error()
    got(worst, ".1e")


@extreme("denoising no light", given="a black image", expected="black: OIDN alone shows up to 8e-4")
def test_black_stays_black(images, got):
    black = np.zeros_like(images["noisy"])
    assert got(cleaned(images | {"noisy": black}).max(), "g") == 0


def test_what_is_not_finite_is_left_to_the_denoiser(images):
    broken = images["noisy"] * np.float32(1e-12)
    broken[3, 3] = np.nan
    assert cleaned(images | {"noisy": broken}).shape == broken.shape


WIDTH, HEIGHT = 24, 16


@pytest.fixture(scope="module")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def view(scene):
    """Tracer, camera, film positions and width of a frame, as the functions take them."""
    camera = scene.camera.resized(WIDTH, HEIGHT)
    return Tracer(scene), camera, frame_positions(camera), WIDTH


def test_rows_run_from_the_top_and_columns_from_the_left(view):
    """What the camera projects to a pixel has its colour there."""
    _, camera, _, _ = view
    albedo, normal = auxiliary_images(*view, spp=4, pattern=0)
    assert albedo.shape == normal.shape == (HEIGHT, WIDTH, 3)
    assert albedo.dtype == normal.dtype == np.float32
    points = np.array([[-0.6, 0.1, 1.2], [-0.6, 1.5, 2.0]])  # on the blue board, and on the wall above it
    (board, wall), _ = camera.project(points)
    np.testing.assert_allclose(albedo[int(board[1]), int(board[0])], [0.2, 0.3, 0.8], atol=1e-5)
    np.testing.assert_allclose(albedo[int(wall[1]), int(wall[0])], [0.7, 0.6, 0.3], atol=1e-5)
    radiance = radiance_image(*view, 16, 0)
    assert radiance.shape == (HEIGHT, WIDTH, 3)
    assert radiance[int(board[1]), int(board[0])].argmax() == 2
    assert radiance[int(wall[1]), int(wall[0])].argmax() == 0


def test_columns_are_the_images_not_the_cameras(view):
    """Boxes of 2 x 2 pixels make an image of half the width."""
    tracer, camera, *_ = view
    left, top = (side.ravel() for side in np.meshgrid(np.arange(0, WIDTH, 2.0), np.arange(0, HEIGHT, 2.0)))
    positions = box_positions(left, top, np.full(left.shape, 2.0), np.full(left.shape, 2.0))
    albedo, _ = auxiliary_images(tracer, camera, positions, WIDTH // 2, spp=64, pattern=0)
    whole, _ = auxiliary_images(*view, spp=64, pattern=0)
    assert albedo.shape == (HEIGHT // 2, WIDTH // 2, 3)
    expected = whole.reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(albedo, expected, atol=0.05)


def test_a_traced_image_has_radiance_and_features_of_one_seed(view):
    traced = trace_image(*view, spp=6, seed=3)
    np.testing.assert_array_equal(traced.radiance, radiance_image(*view, 6, 3))
    for found, expected in zip((traced.albedo, traced.normal), auxiliary_images(*view, 6, 3), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6)
    # A single sample of the features would be too noisy: they have four; more than 16 help no longer.
    for spp, of_features in ((1, 4), (17, 16)):
        albedo, _ = auxiliary_images(*view, of_features, 3)
        np.testing.assert_allclose(trace_image(*view, spp=spp, seed=3).albedo, albedo, atol=1e-6)
    assert not np.array_equal(trace_image(*view, spp=6, seed=4).radiance, traced.radiance)


@pytest.mark.parametrize(("spp", "wanted"), [(1, 4), (2, 4), (6, 6), (20, 16)])
def test_auxiliary_features_may_have_other_numbers_of_samples_than_radiance(view, spp, wanted):
    traced = trace_image(*view, spp, seed=3)
    np.testing.assert_array_equal(traced.radiance, radiance_image(*view, spp, 3))
    albedo, normal = auxiliary_images(*view, wanted, pattern=3)
    np.testing.assert_allclose(traced.albedo, albedo, atol=1e-5)
    np.testing.assert_allclose(traced.normal, normal, atol=1e-5)


def test_positions_may_have_different_numbers_of_samples(view):
    """Where there are 64 times as many samples, there is less noise."""
    counts = np.where(np.arange(WIDTH * HEIGHT) % 2, 64, 1)
    truth = radiance_image(*view, 1024, 9)
    squares = ((radiance_image(*view, counts, 0) - truth) ** 2).reshape(-1, 3)
    assert squares[counts == 64].mean() < squares[counts == 1].mean() / 8


def test_denoising_uses_the_images_own_features(view):
    traced = trace_image(*view, spp=4, seed=1)
    named = {"radiance": traced.radiance, "albedo": traced.albedo, "normal": traced.normal}
    np.testing.assert_array_equal(traced.denoised(), denoise(**named))
    np.testing.assert_array_equal(traced.denoised(quick=True), denoise(**named, quick=True))
    assert not np.array_equal(traced.denoised(), traced.denoised(quick=True))
    assert not np.array_equal(traced.denoised(), traced.radiance)
