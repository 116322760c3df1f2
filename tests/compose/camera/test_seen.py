"""What views have seen: the kernel against a plain twin, and what is hidden, behind or infinitely far."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import Camera, camera_from_pose, look_at
from compose.camera.seen_surfaces import SeenSurfaces
from tests.extremes import extreme

FAR = 1e18


def view(position, target, width=40, height=30) -> Camera:
    pose = look_at(np.array(position, float), np.array(target, float), np.array([0.0, 1, 0]))
    return camera_from_pose(pose, width, height, 32, 30, 20.5, 14)


def plain_finest(cameras, depths, points):
    """The twin: numpy, float64, one point after the other."""
    sizes = [[] for _ in points]
    least = min(3, len(cameras))
    for camera, grid in zip(cameras, depths.astype(np.float64), strict=True):
        rows, columns = grid.shape
        for number, point in enumerate(points):
            pixel, depth = (value[0] for value in camera.project(point[None].astype(np.float64)))
            column, row = pixel[0] * columns / camera.width, pixel[1] * rows / camera.height
            if not (depth > 0 and 0 <= column < columns and 0 <= row < rows):
                continue
            i, j = int(np.floor(row - 0.5)), int(np.floor(column - 0.5))
            around = [
                grid[np.clip(i + a, 0, rows - 1), np.clip(j + b, 0, columns - 1)]
                for a in (0, 1)
                for b in (0, 1)
            ]
            if depth <= 1.02 * max(around):
                sizes[number].append(depth / camera.fy)
    return np.array([sorted(size)[least - 1] if len(size) >= least else np.inf for size in sizes])


def test_the_kernel_matches_its_twin(each_arrays):
    rng = np.random.default_rng(3)
    cameras = [view(rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3)) for _ in range(7)]
    depths = rng.uniform(1, 4, (7, 6, 8)).astype(np.float32)
    points = rng.uniform(-3, 3, (500, 3)).astype(np.float32)
    found = SeenSurfaces(each_arrays, cameras, depths).finest(points)
    expected = plain_finest(cameras, depths, points)
    assert 0.02 < np.isfinite(expected).mean() < 0.9
    # Points at the very edge of a cell may fall to either side in float32.
    same = np.isclose(found, expected, rtol=1e-4) | (np.isinf(found) & np.isinf(expected))
    assert same.mean() > 0.99


@pytest.mark.parametrize(("distances", "counts"), [((2,), 2), ((3, 2), 3), ((5, 2, 4, 3), 4)])
def test_the_third_nearest_view_counts_or_the_furthest_of_fewer(arrays, distances, counts):
    cameras = [view([0, 0, -distance], [0, 0, 0]) for distance in distances]
    seen = SeenSurfaces(arrays, cameras, np.full((len(cameras), 4, 4), 10, np.float32))
    np.testing.assert_allclose(seen.finest(np.zeros((1, 3), np.float32)), counts / 30, rtol=1e-5)


def test_what_is_hidden_or_behind_was_not_seen(arrays):
    seen = SeenSurfaces(arrays, [view([0, 0, -4], [0, 0, 0])], np.full((1, 4, 4), 5, np.float32))
    found = seen.finest(np.array([[0, 0, 0.9], [0, 0, 2], [0, 0, -9]], np.float32))
    assert np.isfinite(found).tolist() == [True, False, False]


@extreme("open sky, seen before", given="points 1e18 away, in and beside a view", expected="seen, not seen")
def test_the_sky_is_seen_by_direction(each_arrays, got):
    camera = view([0, 0, -4], [0, 0, 0])
    seen = SeenSurfaces(each_arrays, [camera], np.full((1, 4, 4), FAR, np.float32))
    found = seen.finest(np.array([[0, 0, FAR], [FAR, 0, 0]], np.float32))
    assert got(np.isfinite(found).tolist()) == [True, False]


@pytest.mark.parametrize("shape", [(0, 4, 4), (2, 4, 4), (1, 0, 4), (4, 4)])
def test_maps_that_do_not_fit_the_views_are_refused(arrays, shape):
    with pytest.raises(ValueError, match="depth maps"):
        SeenSurfaces(arrays, [view([0, 0, -4], [0, 0, 0])] * min(shape[0], 1), np.zeros(shape, np.float32))
