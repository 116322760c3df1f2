"""The disc as images in the rectangle around it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np
import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.disc import Disc
from compose.fovea.foveation import Foveation
from compose.fovea.samples import Samples
from hybrid.render import disc_images as module
from hybrid.render.disc_images import DiscImages, Underlay, parents_of
from tests import small
from tests.compose.arrays_of import channels, host, image_on, numbers

WIDTH, HEIGHT = 48, 40
CAMERA = Camera(np.eye(4), WIDTH, HEIGHT, 50.0, 50.0, WIDTH / 2, HEIGHT / 2)
REGION = Foveation(Gaze(0.4, 0.6), 40, 20).region(WIDTH, HEIGHT)


@pytest.fixture
def disc(arrays) -> Disc:
    return REGION.disc(arrays)


def samples(disc: Disc, count: float) -> Samples:
    """Different values in every channel of every pixel."""
    rng, arrays = small.rng(int(count)), disc.arrays
    triples = [rng.uniform(size=(disc.count, 3)).astype(np.float32) for _ in range(5)]
    radiance, squares, albedo, normal, position = triples
    images = (channels(arrays, of) for of in (radiance, squares + 1, albedo, normal, position))
    counts, nothing, some = (
        dr.full(arrays.plain.Float, value, disc.count) for value in (count, 0, count / 4)
    )
    return Samples(disc.pixels, counts, *images, nothing, nothing, some)


def around(disc: Disc, value: float) -> list[Any]:
    """Three channels of one value in all of the rectangle."""
    return [dr.full(disc.arrays.plain.Float, value, int(np.prod(disc.shape)))] * 3


def image(disc: Disc, values: list[Any]) -> np.ndarray:
    """(h, w, C) image of the rectangle."""
    return host(values).reshape(*disc.shape, len(values))


def of_disc(disc: Disc, values: np.ndarray) -> np.ndarray:
    """(D, C) values of the disc's pixels in an image of the rectangle."""
    return values.reshape(-1, values.shape[-1])[np.asarray(disc.inside)]


@pytest.fixture
def denoisers(monkeypatch):
    """Names of the denoisers that are called; each returns radiance, albedo and normal added up."""
    called = []

    def add(radiance, albedo, normal, quick=False):
        called.append("quick" if quick else "fine")
        return radiance + albedo + normal

    monkeypatch.setattr(module, "denoise", add)
    return called


def test_samples_lie_at_their_pixels_and_the_surroundings_fill_the_corners(disc):
    known = samples(disc, 5)
    images = DiscImages.of(disc, known, around(disc, 2.5))
    inside = np.zeros((HEIGHT, WIDTH), dtype=bool)
    inside.reshape(-1)[REGION.pixels] = True
    inside = inside[REGION.box]
    assert (~inside).any()
    # An albedo lies in 0..1; a surrounding pixel counts as a single sample.
    for name, filled in (("radiance", 2.5), ("albedo", 1), ("normal", 0)):
        found = image(disc, getattr(images, name))
        np.testing.assert_array_equal(found[inside], numbers(known, name))
        assert (found[~inside] == filled).all()
    count = image(disc, [images.count])
    np.testing.assert_array_equal(count[inside], np.full((REGION.count, 1), 5))
    assert (count[~inside] == 1).all()


@pytest.mark.parametrize(("quick", "used"), [(True, ["quick"]), (False, ["fine"])])
def test_a_quicker_denoiser_is_used_only_if_asked_for(quick, used, disc, denoisers):
    images = DiscImages(disc, around(disc, 1), around(disc, 2), around(disc, 3), around(disc, 1)[0])
    denoised = images.denoised(quick)
    assert denoised.shape == (*disc.shape, 3)
    assert (np.array(denoised) == 6).all()
    assert denoisers == used


def test_all_parents_are_crops_of_one_rectangle(disc, denoisers):
    known = samples(disc, 4)
    splats = small.rng(9).uniform(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    found = parents_of(disc, known, Underlay(CAMERA, image_on(disc.arrays, splats))).images()
    np.testing.assert_array_equal(found["splat"], splats[REGION.box])
    images = DiscImages.of(disc, known, channels(disc.arrays, splats[REGION.box].reshape(-1, 3)))
    radiance, albedo, normal = (image(disc, of) for of in (images.radiance, images.albedo, images.normal))
    np.testing.assert_array_equal(found["traced"], radiance)
    np.testing.assert_array_equal(found["denoised"], radiance + albedo + normal)
    np.testing.assert_array_equal(found["albedo"], albedo)
    np.testing.assert_array_equal(found["count"], image(disc, [images.count]))
    np.testing.assert_array_equal(of_disc(disc, found["earlier"])[:, 0], numbers(known, "earlier"))
    np.testing.assert_array_equal(of_disc(disc, found["variance"]), numbers(known, "variance"))
    # Nothing is traced outside the disc.
    assert np.isinf(found["variance"]).sum() == 3 * (np.prod(disc.shape) - disc.count)


def test_parents_in_a_hurry_have_no_denoised_samples(disc, denoisers):
    splats = image_on(disc.arrays, np.zeros((HEIGHT, WIDTH, 3), dtype=np.float32))
    assert parents_of(disc, samples(disc, 64), Underlay(CAMERA, splats), quick=True).denoised is None
    assert not denoisers


@pytest.mark.parametrize("value", [1e15, 1e30, float(np.finfo(np.float32).max), np.inf])
def test_denoising_leaves_a_firefly_alone(disc, value):
    """As if its pixel were the mean of its neighbours; a finite one stays in the denoised disc as it is."""
    known = samples(disc, 5)
    radiance = numbers(known, "radiance")
    radiance[disc.count // 2] = value
    bright = replace(known, radiance=channels(disc.arrays, radiance))
    images = DiscImages.of(disc, bright, around(disc, 0.5))
    fine = np.array(images.denoised(quick=False))
    assert (of_disc(disc, fine) < 2).all(axis=1).sum() >= disc.count - 1
    where = (image(disc, images.radiance) == np.float32(value)).all(axis=2)
    assert where.any()
    assert (fine[where] == np.float32(value)).all()
    grey = Underlay(CAMERA, image_on(disc.arrays, np.full((HEIGHT, WIDTH, 3), 0.5, dtype=np.float32)))
    fused, plain = (parents_of(disc, of, grey).denoised.numpy() for of in (bright, known))
    assert np.median(np.abs(fused - plain)) < 0.02


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 1e30])
def test_surroundings_that_cannot_be_radiance_are_black(disc, value):
    found, black = (DiscImages.of(disc, samples(disc, 5), around(disc, radiance)) for radiance in (value, 0))
    for one, other in ((found.radiance, black.radiance), (found.albedo, black.albedo)):
        np.testing.assert_array_equal(host(one), host(other))
