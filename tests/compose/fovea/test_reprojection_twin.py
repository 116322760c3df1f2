"""Reprojection against its plain twin: random scenes and extreme ones."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from compose.base.traced_samples import ALWAYS, STILL, UNSTEADY, Moment
from compose.camera.camera import Camera, camera_from_pose, look_at
from compose.fovea.reprojection import MOST_VIEWS, EarlierViews, reproject
from compose.fovea.samples import RECORD
from tests import small
from tests.compose.arrays_of import PlainReprojected, PlainSamples, PlainView
from tests.compose.fovea.plain_reprojection import plain_reproject
from tests.compose.fovea.views import random_moment

WIDTH, HEIGHT = 64, 40


def eye(
    rng: np.random.Generator, step: float = 0.1, size: tuple[int, int] = (WIDTH, HEIGHT), fov: float = 60
) -> Camera:
    """A camera near (0, 0, -3), looking towards somewhere near the origin; the field of view is vertical."""
    position, target = np.array([0, 0, -3.0]) + rng.normal(0, step, 3), rng.normal(0, step, 3)
    width, height = size
    focal = 0.5 * height / np.tan(np.radians(fov / 2))
    pose = look_at(position, target, np.array([0, -1.0, 0]))
    return camera_from_pose(pose, width, height, focal, focal, width / 2, height / 2)


def ground(view: Camera, pixels: np.ndarray, rng: np.random.Generator, sky: float = 0.1) -> np.ndarray:
    """(D, 3) points that pixels show: steps of a wall, with holes through which the sky shows."""
    centre = np.stack([pixels % view.width, pixels // view.width], axis=1) + rng.random((len(pixels), 2))
    rays = view.rays(centre)
    flat = view.position - rays * (view.position[2] / np.where(np.abs(rays[:, 2:]) < 1e-3, 1e-3, rays[:, 2:]))
    depth = np.where(np.sin(4 * flat[:, 0]) * np.sin(5 * flat[:, 1]) > 0.2, -1.0, 0.5)
    point = view.position + rays * ((depth - view.position[2]) / np.maximum(rays[:, 2], 1e-2))[:, None]
    return np.where((rng.random(len(pixels)) < sky)[:, None], view.position + rays * 1e5, point)


def gloss_of(position: np.ndarray) -> np.ndarray:
    """(D,) class of gloss, in patches of the world."""
    return (np.floor(position[:, 0] * 3).astype(np.int64) % 3).astype(np.uint8)


def mover_of(position: np.ndarray) -> np.ndarray:
    """(D,) what moves, in other patches: nothing, two movers, or something unsteady."""
    patch = np.floor(position[:, 1] * 3).astype(np.int64) % 4
    return np.array([STILL, 1, 2, UNSTEADY], dtype=np.uint16)[patch]


def disc(view: Camera, rng: np.random.Generator, radius: float, middle: tuple[float, float]) -> PlainSamples:
    """New samples of a disc around a middle, radius and middle relative to the frame."""
    row, column = np.divmod(np.arange(view.width * view.height), view.width)
    away = np.hypot(column + 0.5 - middle[0] * view.width, row + 0.5 - middle[1] * view.height)
    pixels = np.flatnonzero(away < radius * view.height).astype(np.uint32)
    position = ground(view, pixels.astype(np.int64), rng).astype(np.float32)
    dark = np.zeros((len(pixels), 3), dtype=np.float32)
    gloss, mover = gloss_of(position), mover_of(position)
    return PlainSamples(pixels, dark[:, 0], dark, dark, dark, dark, position, gloss, mover, dark[:, 0])


def remembered(
    view: Camera,
    rng: np.random.Generator,
    radius: float = 0.6,
    middle: tuple[float, float] = (0.5, 0.5),
    time: float = 0.0,
) -> PlainView:
    """What was traced of a disc."""
    new = disc(view, rng, radius, middle)
    count = rng.integers(1, 33, len(new.pixels)).astype(np.float32)
    records = rng.lognormal(0, 2, (len(count), RECORD)) * count[:, None]
    records[:, 0], records[:, -1] = count, 0
    return PlainView(records.astype(np.float32), new.position, new.gloss, new.mover, view.position, time)


def again(known: EarlierViews, view: Camera, new: PlainSamples) -> PlainReprojected | None:
    """What the kernels find."""
    found = reproject(known, view, new.on(known.arrays), new.box(view.width))
    return None if found is None else PlainReprojected.of(found)


def both(
    arrays, views: list[PlainView], view: Camera, new: PlainSamples, moment: Moment = ALWAYS
) -> tuple[PlainReprojected, PlainReprojected]:
    """What the kernels and the plain twin find."""
    known = EarlierViews(arrays)
    known.moment = moment
    for earlier in views:
        known.add(earlier.on(arrays))
    found, expected = again(known, view, new), plain_reproject(views, view, new, moment)
    assert found is not None
    if expected is None:
        expected = replace(found, records=np.zeros_like(found.records))
    assert (found.rows, found.columns) == (expected.rows, expected.columns)
    return found, expected


def assert_equal(found: PlainReprojected, expected: PlainReprojected) -> None:
    """Counts are whole numbers, exact; sums are float32."""
    np.testing.assert_array_equal(found.records[..., 0], expected.records[..., 0])
    np.testing.assert_allclose(found.records, expected.records, rtol=2e-6, atol=1e-9)


@pytest.mark.parametrize("views", [1, 2, 5, MOST_VIEWS])
@pytest.mark.parametrize("step", [0.0, 0.002, 0.1], ids=["still", "creep", "walk"])
def test_random_scenes(arrays, views, step):
    rng = small.rng(views)
    path = [eye(rng, step) for _ in range(views + 1)]
    new = disc(path[-1], rng, 0.5, (0.5, 0.5))
    found, expected = both(arrays, [remembered(view, rng) for view in path[:-1]], path[-1], new)
    assert expected.records.sum() > 0
    assert_equal(found, expected)


@pytest.mark.parametrize(
    ("size", "fov"), [((64, 40), 175.0), ((64, 40), 1.0), ((7, 90), 60.0), ((90, 7), 60.0), ((1, 1), 60.0)]
)
def test_extreme_fields_of_view_and_frames(arrays, size, fov):
    rng = small.rng()
    path = [eye(rng, 0.05, size, fov) for _ in range(5)]
    new = disc(path[-1], rng, 10, (0.5, 0.5))
    assert len(new.pixels) == size[0] * size[1]
    assert_equal(*both(arrays, [remembered(view, rng, 10) for view in path[:-1]], path[-1], new))


@pytest.mark.parametrize("middle", [(0, 0), (1, 1), (0.0, 0.5), (0.5, 1.2)])
def test_a_disc_that_the_edge_of_the_frame_cuts(arrays, middle):
    rng = small.rng()
    path = [eye(rng, 0.02) for _ in range(4)]
    views = [remembered(view, rng, 0.5, middle) for view in path[:-1]]
    assert_equal(*both(arrays, views, path[-1], disc(path[-1], rng, 0.4, middle)))


def test_discs_that_do_not_overlap(arrays):
    rng, view = small.rng(), eye(small.rng())
    earlier = remembered(view, rng, 0.2, (0.1, 0.2))
    found, expected = both(arrays, [earlier], view, disc(view, rng, 0.2, (0.9, 0.8)))
    assert_equal(found, expected)
    assert not found.records.any()


def test_views_without_samples(arrays):
    rng = small.rng()
    path = [eye(rng) for _ in range(3)]
    full = [remembered(view, rng) for view in path[:-1]]
    none = remembered(path[0], rng, 0.0)
    assert len(none.records) == 0
    new = disc(path[-1], rng, 0.5, (0.5, 0.5))
    assert_equal(*both(arrays, [none, full[0], none, full[1], none], path[-1], new))
    known = EarlierViews(arrays)
    assert again(known, path[-1], new) is None
    known.add(none.on(arrays))
    assert again(known, path[-1], new) is None
    known.add(full[0].on(arrays))
    assert again(known, path[-1], new.part(slice(0, 0))) is None


def test_points_behind_and_at_the_camera_and_beyond_all_numbers(arrays):
    rng, view = small.rng(), eye(small.rng(), 0.0)
    new = disc(view, rng, 0.5, (0.5, 0.5))
    point = np.concatenate(
        [
            rng.normal((0, 0, -6), 1, (200, 3)),  # behind
            np.repeat(view.position[None], 3, axis=0),  # at the camera
            view.position + np.array([[0, 0, 1e-30], [0, 1e-30, 0], [1e-6, 0, 1e-6]]),
            [[1e30, 0, 1], [0, -1e30, 1], [0, 0, 1e30], [np.inf, 0, 1], [np.nan, 0, 0]],
            rng.normal(0, 1e5, (200, 3)),
        ]
    ).astype(np.float32)
    for viewpoint in (view.position, view.position + 0.1):
        size = len(point)
        records = rng.random((size, RECORD)).astype(np.float32)
        records[:, 0] = 1
        at = np.zeros((size, 3))
        earlier = PlainView(records, point, gloss_of(at), mover_of(at), viewpoint)
        with np.errstate(all="ignore"):
            found, expected = both(arrays, [earlier], view, new)
        assert_equal(found, expected)


def test_points_on_the_borders_of_quarters(arrays):
    """A camera whose numbers are powers of two, and points at whole quarters: exact in any arithmetic."""
    pose = np.eye(4)
    pose[2, 3] = -4
    view = camera_from_pose(pose, 32, 16, 16, 16, 16, 8)
    every = np.arange(32 * 16, dtype=np.int64)
    centre = view.rays(view.pixel_centres())
    position = (view.position + centre * (4 / centre[:, 2:])).astype(np.float32)
    dark = np.zeros((len(every), 3), dtype=np.float32)
    gloss = np.zeros(len(every), dtype=np.uint8)
    still = gloss.astype(np.uint16)
    none = dark[:, 0]
    new = PlainSamples(every.astype(np.uint32), none, *[dark] * 4, position, gloss, still, none)
    x, y = np.meshgrid(np.arange(-4, 4.125, 0.125), np.arange(-2, 2.125, 0.125))
    point = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(np.float32)
    records = np.ones((len(point), RECORD), dtype=np.float32)
    gloss, still = np.zeros(len(point), dtype=np.uint8), np.zeros(len(point), dtype=np.uint16)
    earlier = PlainView(records, point, gloss, still, view.position)
    found, expected = both(arrays, [earlier], view, new)
    assert_equal(found, expected)
    # Four quarters per pixel, each with the point in its upper left corner.
    assert (found.records[..., 0] == 4).all()


def walked(arrays, seed: int) -> list[PlainReprojected]:
    """What a long walk reprojects; the discs differ in size, so that the ring wraps around and grows."""
    rng, known, found = small.rng(seed), EarlierViews(arrays), []
    for step in range(40):
        view = eye(rng, 0.02)
        known.add(remembered(view, rng, 0.1 + 0.9 * (step % 7 == 6)).on(arrays))
        now = eye(rng, 0.02)
        found.append(again(known, now, disc(now, rng, 0.5, (0.5, 0.5))))
    return found


def test_only_the_last_views_count_however_long_the_walk(arrays):
    rng, known, last = small.rng(), EarlierViews(arrays), []
    for step in range(40):
        view = eye(rng, 0.02)
        last = [*last, remembered(view, rng, 0.1 + 0.9 * (step % 7 == 6))][-MOST_VIEWS:]
        known.add(last[-1].on(arrays))
        assert known.samples == sum(len(view.records) for view in last)
        now = eye(rng, 0.02)
        new = disc(now, rng, 0.5, (0.5, 0.5))
        assert_equal(again(known, now, new), plain_reproject(last, now, new))


def test_the_same_samples_give_the_same_sums_bit_by_bit(arrays):
    for one, other in zip(walked(arrays, 3), walked(arrays, 3), strict=True):
        np.testing.assert_array_equal(one.records, other.records)


def test_no_kernel_is_compiled_when_camera_gaze_or_sizes_change(arrays):
    walked(arrays, 0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        walked(arrays, 1)
        kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(entry["cache_hit"] for entry in kernels)


@pytest.mark.parametrize("size", [0.0, 0.01, 0.3])
def test_movers_take_their_samples_along(arrays, size):
    """Views of the same moment and of others, from the same viewpoint and from others."""
    rng = small.rng(int(100 * size))
    views = [eye(rng, 0.02), eye(rng, 0.02)]
    known = [remembered(view, rng, time=time) for time in (0.2, 0.4) for view in views]
    for view in views:
        new = disc(view, rng, 0.5, (0.5, 0.5))
        assert_equal(*both(arrays, known, view, new, random_moment(rng, 0.4, size)))
