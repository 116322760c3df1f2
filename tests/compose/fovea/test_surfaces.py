"""The surfaces that are visible around pixels, against a plain float64 twin and by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.base.traced_samples import DIFFUSE, GLOSSY, SPECULAR
from compose.camera.camera import Camera
from compose.fovea.reprojection import VisibleSurfaces
from compose.image.device_image import shape_of
from tests import small
from tests.compose.arrays_of import PlainSamples
from tests.compose.fovea.views import SIZE, camera, samples, wall

VIEW = camera(0.4, 10.0)
# Rows 20 to 24 and columns 30 to 36.
TOP, LEFT, HEIGHT, WIDTH = 20, 30, 5, 7


def chosen(distance: np.ndarray, gloss: np.ndarray | int = DIFFUSE, seed: int = 0) -> PlainSamples:
    """Samples in any order of the rectangle's pixels, at distances (HEIGHT, WIDTH); none where it is nan."""
    row, column = np.nonzero(~np.isnan(distance))
    order = small.rng(seed).permutation(len(row))
    row, column = row[order], column[order]
    index = (TOP + row) * SIZE + LEFT + column
    ray = VIEW.rays(VIEW.pixel_centres()[index])
    found = samples(VIEW.position + ray * distance[row, column, None], np.zeros(3))
    classes = np.broadcast_to(np.asarray(gloss, dtype=np.uint8), distance.shape)[row, column]
    return replace(found, pixels=index.astype(np.uint32), gloss=classes)


def surfaces_of(arrays: Arrays, new: PlainSamples, view: Camera = VIEW) -> VisibleSurfaces:
    """The surfaces in the rectangle around samples."""
    return VisibleSurfaces.of(arrays, view, new.on(arrays), new.box(view.width))


def table(surfaces: VisibleSurfaces) -> np.ndarray:
    """(h, w, 4)."""
    return surfaces.table.numpy().reshape(*shape_of(surfaces.box), 4)


def contained(
    surfaces: VisibleSurfaces,
    pixel: np.ndarray,
    distance: np.ndarray | float,
    gloss: np.ndarray | int = DIFFUSE,
    active: np.ndarray | bool = True,
) -> np.ndarray:
    """Whether hits lie on the surfaces."""
    plain, shape = surfaces.arrays.plain, np.shape(pixel)
    arguments = (
        plain.UInt(np.asarray(pixel, dtype=np.uint32)),
        plain.Float(np.broadcast_to(distance, shape).astype(np.float32)),
        plain.UInt(np.broadcast_to(gloss, shape).astype(np.uint32)),
        plain.Bool(np.broadcast_to(active, shape).copy()),
    )
    return surfaces.contain(*arguments).numpy()


def twin(distance: np.ndarray, row: int, column: int) -> tuple[float, float]:
    """The least and the greatest distance in a pixel and the eight around it; inf and 0 without any."""
    around = distance[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    around = around[~np.isnan(around)]
    return (around.min(), around.max()) if len(around) else (np.inf, 0.0)


def random_distances(seed: int) -> np.ndarray:
    """Distances with holes, of which one is wider than what is around a pixel; all edges are touched."""
    rng = small.rng(seed)
    distance = rng.uniform(1, 20, (HEIGHT, WIDTH))
    distance[rng.uniform(size=distance.shape) < 0.4] = np.nan
    distance[0:3, 3:6] = np.nan
    distance[[0, HEIGHT - 1], [0, WIDTH - 1]] = 5.0
    return distance


@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_and_the_farthest_of_nine_pixels_are_found(seed, arrays):
    distance = random_distances(seed)
    surfaces = surfaces_of(arrays, chosen(distance, seed=seed))
    assert surfaces.box == (slice(20, 25), slice(30, 37))
    assert shape_of(surfaces.box) == (HEIGHT, WIDTH)
    found = table(surfaces)
    for row, column in np.ndindex(HEIGHT, WIDTH):
        least, greatest = twin(distance, row, column)
        # Half a percent beyond them is still the same surface.
        np.testing.assert_allclose(found[row, column, :2], [0.995 * least, 1.005 * greatest], rtol=1e-5)
    assert (found[..., 3] == 0).all()
    assert np.isinf(found[1, 4, 0])


@pytest.mark.parametrize("seed", range(3))
def test_hits_lie_on_surfaces_as_the_twin_says(seed, arrays):
    rng, distance = small.rng(seed + 10), random_distances(seed)
    gloss = rng.integers(0, 3, distance.shape)
    surfaces = surfaces_of(arrays, chosen(distance, gloss, seed))
    pixel = rng.integers(0, HEIGHT * WIDTH, 4000)
    hit, kind, active = rng.uniform(0.5, 22, 4000), rng.integers(0, 3, 4000), rng.uniform(size=4000) < 0.9
    found = contained(surfaces, pixel, hit, kind, active)
    expected, certain = np.zeros(4000, dtype=bool), np.zeros(4000, dtype=bool)
    for number, (row, column) in enumerate(zip(*np.divmod(pixel, WIDTH), strict=True)):
        least, greatest = twin(distance, row, column)
        ends = np.array([least / hit[number] * 0.995, greatest / hit[number] * 1.005])
        mirrors = gloss[row, column] == SPECULAR and not np.isnan(distance[row, column])
        expected[number] = active[number] and ends[0] <= 1 <= ends[1]
        expected[number] &= not mirrors or kind[number] == SPECULAR
        certain[number] = (np.abs(ends - 1) > 1e-5).all()
    assert certain.mean() > 0.99
    assert 0.1 < expected.mean() < 0.9
    np.testing.assert_array_equal(found[certain], expected[certain])


@pytest.mark.parametrize("shown", [DIFFUSE, GLOSSY, SPECULAR])
@pytest.mark.parametrize("kind", [DIFFUSE, GLOSSY, SPECULAR])
def test_only_what_is_specular_lies_on_a_specular_pixel_itself(shown, kind, arrays):
    gloss = np.full((HEIGHT, WIDTH), DIFFUSE)
    gloss[2, 3] = shown
    surfaces = surfaces_of(arrays, chosen(np.full((HEIGHT, WIDTH), 4.0), gloss))
    found = contained(surfaces, np.arange(HEIGHT * WIDTH), 4.0, kind).reshape(HEIGHT, WIDTH)
    assert found[2, 3] == (shown != SPECULAR or kind == SPECULAR)
    found[2, 3] = True
    assert found.all()
    mirrors = np.zeros((HEIGHT, WIDTH))
    mirrors[2, 3] = shown == SPECULAR
    np.testing.assert_array_equal(table(surfaces)[..., 2], mirrors)


@pytest.mark.parametrize(("distance", "same"), [(3.979, False), (3.981, True), (4.019, True), (4.021, False)])
def test_distances_may_differ_by_half_a_percent(distance, same, arrays):
    surfaces = surfaces_of(arrays, chosen(np.full((HEIGHT, WIDTH), 4.0)))
    assert (contained(surfaces, np.arange(HEIGHT * WIDTH), distance) == same).all()


def test_a_single_sample_is_a_rectangle_of_one_pixel(arrays):
    distance = np.full((HEIGHT, WIDTH), np.nan)
    distance[2, 3] = 7.0
    surfaces = surfaces_of(arrays, chosen(distance, SPECULAR))
    assert surfaces.box == (slice(22, 23), slice(33, 34))
    np.testing.assert_allclose(table(surfaces), [[[7 * 0.995, 7 * 1.005, 1, 0]]], rtol=1e-5)
    found = contained(surfaces, np.zeros(4), np.array([6.9, 7.0, 7.0, 7.1]), [SPECULAR] * 2 + [DIFFUSE] * 2)
    assert found.tolist() == [False, True, False, False]


def test_hits_that_are_not_in_question_lie_on_nothing(arrays):
    surfaces = surfaces_of(arrays, chosen(np.full((HEIGHT, WIDTH), 4.0)))
    asked = np.arange(HEIGHT * WIDTH) % 3 == 0
    for distance in (4.0, np.where(asked, 4.0, 0.0)):
        found = contained(surfaces, np.arange(HEIGHT * WIDTH), distance, active=asked)
        np.testing.assert_array_equal(found, asked)


@pytest.mark.parametrize("view", [camera(), VIEW], ids=["ahead", "turned"])
def test_all_pixels_of_a_frame_have_surfaces(view: Camera, arrays):
    """The corners, too, where five of the nine pixels do not exist."""
    shown = samples(wall(view), np.zeros(3))
    surfaces = surfaces_of(arrays, shown, view)
    assert surfaces.box == (slice(0, SIZE), slice(0, SIZE))
    distance = np.linalg.norm(wall(view) - view.position, axis=1)
    assert contained(surfaces, np.arange(SIZE**2), distance).all()
    assert not contained(surfaces, np.arange(SIZE**2), 1.1 * distance).any()
    assert not contained(surfaces, np.arange(SIZE**2), 0.9 * distance).any()


def test_the_order_of_samples_does_not_matter(arrays):
    shown = chosen(random_distances(4), SPECULAR)
    one, other = (table(surfaces_of(arrays, given)) for given in (shown, shown.part(slice(None, None, -1))))
    np.testing.assert_array_equal(one, other)
