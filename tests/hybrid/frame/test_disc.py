"""The disc as images in the rectangle around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from compose.fovea.samples import Samples
from hybrid.frame import disc
from hybrid.frame.disc import DiscImages, denoised_for_fusion, parents_of
from hybrid.frame.underlay import Underlay
from tests import small

WIDTH, HEIGHT = 48, 40
CAMERA = Camera(np.eye(4), WIDTH, HEIGHT, 50.0, 50.0, WIDTH / 2, HEIGHT / 2)
REGION = Foveation(Gaze(0.4, 0.6), 40, 20).region(WIDTH, HEIGHT)


def samples(count: float) -> Samples:
    """Different values in every channel of every pixel."""
    pixels = REGION.pixels
    rng = small.rng(int(count))
    triples = [rng.uniform(size=(len(pixels), 3)).astype(np.float32) for _ in range(5)]
    radiance, squares, albedo, normal, position = triples
    counts = np.full(len(pixels), count, dtype=np.float32)
    gloss, mover = np.zeros(len(pixels), np.uint8), np.zeros(len(pixels), np.uint16)
    return Samples(pixels, counts, radiance, squares + 1, albedo, normal, position, gloss, mover)


@pytest.fixture
def denoisers(monkeypatch):
    """Names of the denoisers that are called; each returns radiance, albedo and normal added up."""
    called = []

    def named(name):
        def add(radiance, albedo, normal, quick=False):
            called.append(f"{name}, quick" if quick else name)
            return radiance + albedo + normal

        return add

    monkeypatch.setattr(disc, "denoise", named("fine"))
    monkeypatch.setattr(disc, "denoise_coarsely", named("coarse"))
    return called


def test_samples_lie_at_their_pixels_and_the_surroundings_fill_the_corners():
    rectangle = REGION.rectangle
    known = samples(5)
    surroundings = np.full((*rectangle.shape, 3), 2.5, dtype=np.float32)
    images = DiscImages.of(known, surroundings, rectangle)
    inside = np.zeros((HEIGHT, WIDTH), dtype=bool)
    inside.reshape(-1)[REGION.pixels] = True
    inside = inside[rectangle.box]
    np.testing.assert_array_equal(images.radiance[inside], known.radiance)
    np.testing.assert_array_equal(images.albedo[inside], known.albedo)
    np.testing.assert_array_equal(images.normal[inside], known.normal)
    np.testing.assert_array_equal(images.count[inside], np.full((len(REGION.pixels), 1), 5))
    assert (~inside).any()
    # An albedo lies in 0..1; a surrounding pixel counts as a single sample.
    for image, filled in zip(
        (images.radiance, images.albedo, images.normal, images.count), (2.5, 1, 0, 1), strict=True
    ):
        assert (image[~inside] == filled).all()


@pytest.mark.parametrize(("quick", "used"), [(True, ["fine, quick", "coarse"]), (False, ["fine", "fine"])])
def test_a_quicker_denoiser_is_used_only_if_asked_for(quick, used, denoisers):
    image = np.ones((4, 4, 3), dtype=np.float32)
    images = DiscImages(image, 2 * image, 3 * image, np.ones((4, 4, 1), dtype=np.float32))
    assert (images.denoised(quick) == 6).all()
    assert (denoised_for_fusion(images, quick) == 6).all()
    assert denoisers == used


def test_all_parents_are_crops_of_one_rectangle(denoisers):
    known = samples(4)
    splats = small.rng(9).uniform(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    parents = parents_of(REGION, known, Underlay(CAMERA, splats, 1.5))
    rectangle = REGION.rectangle
    np.testing.assert_array_equal(parents.splat, splats[rectangle.box])
    images = DiscImages.of(known, parents.splat, rectangle)
    np.testing.assert_array_equal(parents.traced, images.radiance)
    np.testing.assert_array_equal(parents.denoised, images.radiance + images.albedo + images.normal)
    np.testing.assert_array_equal(parents.albedo, images.albedo)
    np.testing.assert_array_equal(parents.normal, images.normal)
    np.testing.assert_array_equal(parents.count, images.count)
    np.testing.assert_array_equal(rectangle.gathered(parents.variance), known.variance())
    # Nothing is traced outside the disc.
    assert np.isinf(parents.variance).sum() == 3 * (np.prod(rectangle.shape) - len(REGION.pixels))
    assert (parents.enlargement, parents.quick) == (1.5, False)


def test_parents_in_a_hurry_use_the_quicker_denoiser_and_say_so(denoisers):
    splats = np.zeros((HEIGHT, WIDTH, 3), dtype=np.float32)
    assert parents_of(REGION, samples(64), Underlay(CAMERA, splats, 1.0), quick=True).quick
    assert denoisers == ["coarse"]


@pytest.mark.parametrize("value", [1e15, 1e30, float(np.finfo(np.float32).max), np.inf])
def test_denoising_leaves_a_firefly_alone(value):
    """As if its pixel were the mean of its neighbours; a finite one stays in the denoised disc as it is."""
    known = samples(5)
    spot = len(REGION.pixels) // 2
    radiance = known.radiance.copy()
    radiance[spot] = value
    surroundings = np.full((*REGION.rectangle.shape, 3), 0.5, dtype=np.float32)
    images, plain = (
        DiscImages.of(replace(known, radiance=light), surroundings, REGION.rectangle)
        for light in (radiance, known.radiance)
    )
    for denoised in (images.denoised(quick=False), denoised_for_fusion(images, quick=True)):
        assert (REGION.rectangle.gathered(denoised) < 2).all(axis=1).sum() >= len(radiance) - 1
    where = (images.radiance == np.float32(value)).all(axis=2)
    assert (images.denoised(quick=False)[where] == np.float32(value)).all()
    difference = np.abs(denoised_for_fusion(images, quick=False) - denoised_for_fusion(plain, quick=False))
    assert np.median(difference) < 0.02


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 1e30])
def test_surroundings_that_cannot_be_radiance_are_black(value):
    surroundings = np.full((*REGION.rectangle.shape, 3), value, dtype=np.float32)
    found, black = (
        DiscImages.of(samples(5), around, REGION.rectangle) for around in (surroundings, black_rectangle())
    )
    np.testing.assert_array_equal(found.radiance, black.radiance)
    np.testing.assert_array_equal(found.albedo, black.albedo)


def black_rectangle() -> np.ndarray:
    """A black image of the rectangle."""
    return np.zeros((*REGION.rectangle.shape, 3), dtype=np.float32)
