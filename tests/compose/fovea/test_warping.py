"""Warped images: the kernel against its twin, and against what is known of planes, outlines and rotations."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from compose.camera.camera import Camera, turned
from compose.fovea.warping import CELL, grid, warped
from compose.image.device_image import DeviceImage
from tests.compose.arrays_of import floats, image_on
from tests.compose.fovea.plain_warping import plain_warped, sampled, seen_from
from tests.extremes import extreme

WIDTH, HEIGHT = 90, 62
CAMERA = Camera(np.eye(4), WIDTH, HEIGHT, 80.0, 84.0, 44.0, 32.0)
# Steps of a viewer: aside, ahead and back, each with a turn.
STEPS = ((0.1, 0.0, 0.0, 2.0), (-0.05, 0.04, 0.2, -3.0), (0.0, 0.0, -0.2, 1.0))


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: float = 0.0) -> Camera:
    """The camera elsewhere, turned to the right by degrees."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned(np.eye(3), turn, turn / 2), (x, y, z)
    return CAMERA.at(pose)


def directions(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """(N, 3) from the camera, in the world, with a depth of 1."""
    rays = camera.rays(pixels)
    return rays / (rays @ camera.camera_to_world[:3, 2])[:, None]


def slanted(camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depths (N,) of a slanted plane, and its colour (N, 3), which is smooth."""
    normal = np.array([0.3, -0.4, 1.0])
    rays = directions(camera, pixels)
    depth = (3.0 - camera.position @ normal) / (rays @ normal)
    point = camera.position + depth[:, None] * rays
    return 1 / depth, 0.5 + 0.4 * np.sin(point @ np.diag([3.0, 4.0, 2.0]))


def two_walls(
    camera: Camera, pixels: np.ndarray, half_width: float = 0.2, away: float = 4.0
) -> tuple[np.ndarray, np.ndarray]:
    """The same of a red rectangle, 1 away, and of a wall farther away, which is green and blue."""
    rays, position = directions(camera, pixels), camera.position
    near, far = (((z - position[2]) / rays[:, 2])[:, None] * rays + position for z in (1.0, away))
    red = (np.abs(near[:, :2]) < (half_width, 0.2)).all(axis=1)
    depth = (np.where(red, 1.0, away) - position[2]) / rays[:, 2]
    wall = np.stack([0 * far[:, 0], 0.6 + 0.3 * np.sin(2 * far[:, 0]), 0.5 + 0.1 * far[:, 1]], axis=1)
    return 1 / depth, np.where(red[:, None], [1.0, 0.0, 0.0], wall)


bar = partial(two_walls, half_width=0.04, away=1.6)


def image_of(scene, camera: Camera) -> np.ndarray:
    """(H, W, 3) what a camera sees."""
    return scene(camera, camera.pixel_centres())[1].reshape(HEIGHT, WIDTH, 3)


def nearness_of(scene) -> np.ndarray:
    """(rows, columns) inverse depths of the cells that CAMERA sees."""
    rows, columns = grid(CAMERA)
    centres = (np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=2) + 0.5) * CELL
    return scene(CAMERA, centres.reshape(-1, 2))[0].reshape(rows, columns)


def shown(arrays, scene, newest: Camera) -> np.ndarray:
    """(H, W, 3) what CAMERA sees, warped."""
    image = image_on(arrays, image_of(scene, CAMERA))
    return warped(image, floats(arrays, nearness_of(scene).ravel()), CAMERA, newest).numpy()


@pytest.mark.parametrize("scene", [slanted, two_walls])
def test_the_kernel_matches_its_twin(each_arrays, scene):
    for step in STEPS:
        newest = moved(*step)
        expected = plain_warped(image_of(scene, CAMERA), nearness_of(scene), CAMERA, newest)
        found = shown(each_arrays, scene, newest)
        # A step that ends at the very edge of a cell may fall to either side in float32.
        assert (np.abs(found - expected).max(axis=2) < 1e-4).mean() > 0.99


def test_a_frame_of_the_newest_camera_stays_as_it_is(arrays):
    image = image_on(arrays, image_of(two_walls, CAMERA))
    nearness = floats(arrays, nearness_of(two_walls).ravel())
    assert warped(image, nearness, CAMERA, replace(CAMERA)) is image


def test_an_upside_down_frame_is_turned_without_a_change(arrays):
    """Every pixel falls on one of the frame's own, so all must keep their values to the bit."""
    camera = replace(CAMERA, cx=WIDTH / 2, cy=HEIGHT / 2)
    image = np.random.default_rng(1).random((HEIGHT, WIDTH, 3), dtype=np.float32)
    flat = floats(arrays, np.zeros(np.prod(grid(camera))))
    newest = replace(camera, world_to_camera=np.diag([-1.0, -1.0, 1.0, 1.0]))
    found = warped(image_on(arrays, image), flat, camera, newest).numpy()
    np.testing.assert_array_equal(found, image[::-1, ::-1])


def test_a_rotation_resamples_whatever_the_depths(arrays):
    newest, image = moved(turn=7.0), image_of(two_walls, CAMERA)
    expected = [sampled(image, seen_from(CAMERA, newest, at, 0.0)) for at in newest.pixel_centres()]
    for nearness in (nearness_of(two_walls), 0 * nearness_of(two_walls)):
        found = warped(image_on(arrays, image), floats(arrays, nearness.ravel()), CAMERA, newest).numpy()
        np.testing.assert_allclose(found.reshape(-1, 3), expected, atol=2e-4)


@pytest.mark.parametrize("step", STEPS)
def test_a_plane_looks_as_if_it_had_been_rendered(arrays, step):
    newest = moved(*step)
    nearness, colour = slanted(newest, newest.pixel_centres())
    pixels = newest.pixel_centres()
    seen = np.array([seen_from(CAMERA, newest, *one) for one in zip(pixels, nearness, strict=True)])
    inside = ((seen > 2) & (seen < (WIDTH - 2, HEIGHT - 2))).all(axis=1)
    assert inside.mean() > 0.7
    error = np.abs(shown(arrays, slanted, newest).reshape(-1, 3) - colour)[inside]
    late = np.abs(image_of(slanted, CAMERA).reshape(-1, 3) - colour)[inside]
    assert error.max() < 0.03 < late.max()


@pytest.mark.parametrize(("scene", "aside"), [(two_walls, -0.06), (two_walls, 0.2), (bar, 0.4)])
def test_what_comes_into_view_shows_what_is_behind(arrays, scene, aside):
    newest = moved(x=aside)
    found, expected = shown(arrays, scene, newest), image_of(scene, newest)
    red = expected[..., 0] > 0.5
    was_red = image_of(scene, CAMERA)[..., 0] > 0.5
    uncovered = was_red & ~red
    assert uncovered.sum() > 20
    # What is near is whole, and there is hardly more of it.
    assert (found[red][:, 0] > 0.5).mean() > 0.99
    assert (found[~red][:, 0] > 0.1).mean() < 0.02
    # Nothing is black, and the wall goes on where it had been hidden.
    assert found.max(axis=2).min() > 0.2
    assert np.abs(found - expected)[uncovered & (found[..., 0] < 0.1)].mean() < 0.1


@extreme(
    "a viewer who has turned round",
    given="a frame warped to a camera that sees nothing of it",
    expected="its border goes on; nothing black",
)
def test_beyond_the_border_the_border_goes_on(arrays, got):
    image = image_of(two_walls, CAMERA)
    for turn in (25.0, 90.0, 180.0):
        found = shown(arrays, two_walls, moved(0.1, 0.0, 0.5, turn))
        assert np.isfinite(found).all()
        assert found.min() >= image.min() - 1e-6
        assert found.max(axis=2).min() > 0.2
    got(f"least {found.max(axis=2).min():.2f} of a largest {image.max():.2f}")


def test_things_before_the_eye_leave_the_others_in_place(arrays):
    """A speck of dust in a corner must not use up all the depths at which a search begins."""
    nearness, newest = nearness_of(two_walls), moved(x=0.06)
    image, expected = image_of(two_walls, CAMERA), image_of(two_walls, newest)
    nearness[0, 0] = 1e5
    found = warped(image_on(arrays, image), floats(arrays, nearness.ravel()), CAMERA, newest).numpy()
    assert (found[expected[..., 0] > 0.5][:, 0] > 0.5).mean() > 0.99


def test_rows_may_have_spare_pixels_and_channels(arrays):
    image, newest = image_of(slanted, CAMERA), moved(*STEPS[1])
    spare = np.pad(image, ((0, 3), (0, 6), (0, 1)), constant_values=9)
    padded = DeviceImage(arrays, floats(arrays, spare.ravel()), WIDTH, HEIGHT, WIDTH + 6, 4)
    found = warped(padded, floats(arrays, nearness_of(slanted).ravel()), CAMERA, newest).numpy()
    np.testing.assert_array_equal(found, shown(arrays, slanted, newest))


def test_sizes_must_fit(arrays):
    image, newest = image_on(arrays, image_of(slanted, CAMERA)), moved(x=0.1)
    nearness = floats(arrays, nearness_of(slanted).ravel())
    with pytest.raises(ValueError, match="cameras of"):
        warped(image, nearness, CAMERA, newest.resized(WIDTH + 1, HEIGHT))
    with pytest.raises(ValueError, match="must be 16 x 23"):
        warped(image, floats(arrays, np.ones(3)), CAMERA, newest)
