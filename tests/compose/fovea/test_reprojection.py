"""Reprojection of single samples, by hand; the ring of earlier views."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from compose.base.traced_samples import DIFFUSE, GLOSSY, SPECULAR, STILL, UNSTEADY, Moment
from compose.camera.camera import Camera
from compose.fovea.reprojection import MOST_MOMENTS, MOST_VIEWS, EarlierViews, Reprojected, reproject
from compose.fovea.samples import RECORD
from tests.compose.arrays_of import PlainReprojected, PlainSamples, PlainView, host, indices
from tests.compose.fovea.views import SIZE, camera, samples, wall

# At (0, 0, -4), looking along +z at a wall at z = 0; one pixel is 1/12 wide there.
VIEW = camera()
WALL = samples(wall(VIEW), np.zeros(3))
PIXEL = 4 / SIZE
ELSEWHERE = np.array([0.05, 0.0, -4.0])


def earlier(
    points: list[list[float]], viewpoint: np.ndarray = ELSEWHERE, gloss: int = DIFFUSE, count: float = 2.0
) -> PlainView:
    """Samples of points; the mean light of number n is n, n + 1, ... n + 5."""
    size = len(points)
    records = np.zeros((size, RECORD), dtype=np.float32)
    records[:, 0] = count
    records[:, 1:7] = count * (np.arange(size)[:, None] + np.arange(6))
    return PlainView(
        records,
        np.array(points, dtype=np.float32),
        np.full(size, gloss, dtype=np.uint8),
        np.zeros(size, dtype=np.uint16),
        viewpoint,
    )


@pytest.fixture
def seen_again(arrays):
    """Reprojects a list of earlier views."""

    def run(views: list[PlainView], view: Camera, new: PlainSamples) -> Reprojected | None:
        known = EarlierViews(arrays)
        for earlier_view in views:
            known.add(earlier_view.on(arrays))
        return reproject(known, view, new.on(arrays), new.box(view.width))

    return run


def at(found: Reprojected, row: list[int], column: list[int]) -> np.ndarray:
    """(D, 16) records of pixels."""
    return host(found.at(indices(found.arrays, np.array(row) * SIZE + column), SIZE))


def count_at(found: Reprojected | None, row: int, column: int) -> float:
    if found is None:
        return 0.0
    return float(at(found, [row], [column])[0, 0])


def test_a_sample_goes_to_the_pixel_in_which_its_point_is_visible(seen_again):
    """World x and image x agree, world y is down: 2.5 and 1.5 pixels off the middle at column and row 24."""
    found = seen_again([earlier([[2.5 * PIXEL, 1.5 * PIXEL, 0]])], VIEW, WALL)
    assert found is not None
    records = at(found, [25, 25, 24], [26, 25, 26])
    assert records[:, 0].tolist() == [2, 0, 0]
    # Twice the light 0, 1, ... 5.
    np.testing.assert_allclose(records[0, 1:7], [0, 2, 4, 6, 8, 10])
    assert records.dtype == np.float32
    assert PlainReprojected.of(found).records[..., 0].sum() == 2


@pytest.mark.parametrize(
    ("point", "row", "column"),
    [
        ([-1.999, -1.999, 0], 0, 0),
        ([1.999, 1.999, 0], 47, 47),
        # Half a unit in front of the camera: 48 * 0.1 / 0.5 = 9.6 pixels off the middle.
        ([0.1, -0.1, -3.5], 14, 33),
    ],
)
def test_points_at_the_edges_and_close_to_the_camera_are_visible(point, row, column, seen_again):
    found = seen_again([earlier([point], VIEW.position)], VIEW, WALL)
    assert count_at(found, row, column) == 2


def test_samples_of_several_views_add_up_in_a_pixel(seen_again):
    inside = [[2.3 * PIXEL, 1.5 * PIXEL, 0], [2.7 * PIXEL, 1.5 * PIXEL, 0]]
    found = seen_again([earlier(inside), earlier(inside[:1], VIEW.position, count=5)], VIEW, WALL)
    assert found is not None
    records = at(found, [25], [26])[0]
    assert records[0] == 2 + 2 + 5
    # Twice 0, twice 1 and five times 0 for the first of six.
    np.testing.assert_allclose(records[1:7], [2, 11, 20, 29, 38, 47])


@pytest.mark.parametrize(
    "point",
    [
        [0.0, 0.0, -8.0],  # behind the camera, in line with the wall
        [2.0, 0.0, 0.0],  # on the right and lower edge, which belong to the next pixel
        [0.0, 2.0, 0.0],
        [-2.001, 0.0, 0.0],  # just beyond the left and upper edge
        [0.0, -2.001, 0.0],
    ],
)
def test_points_out_of_view_are_dropped(point, seen_again):
    assert not np.array(seen_again([earlier([point], VIEW.position)], VIEW, WALL).records).any()


def test_only_the_rectangle_around_the_new_samples_counts(seen_again):
    """Rows 20 to 22 and columns 30 to 33; outside it, nothing is known."""
    pixels = np.array([20 * SIZE + 30, 21 * SIZE + 33, 22 * SIZE + 31], dtype=np.uint32)
    new = WALL.part(pixels.astype(int))
    points = [
        [(c + 0.5 - 24) * PIXEL, (r + 0.5 - 24) * PIXEL, 0]
        for r, c in ((20, 30), (22, 33), (23, 31), (21, 29))
    ]
    found = seen_again([earlier(points, VIEW.position)], VIEW, new)
    assert found is not None
    assert found.box == (slice(20, 23), slice(30, 34))
    assert PlainReprojected.of(found).records.shape == (3, 4, RECORD)
    rows, columns = [20, 22, 23, 21, 19], [30, 33, 31, 29, 30]
    assert at(found, rows, columns)[:, 0].tolist() == [2, 2, 0, 0, 0]
    assert at(found, [20], [34])[:, 0].tolist() == [0]


# Limits are half a percent beyond the nearest and farthest of nine pixels, at 4.0004 and 4.0039.
@pytest.mark.parametrize(("depth", "kept"), [(4.020, True), (3.982, True), (4.027, False), (3.978, False)])
def test_a_point_that_is_not_on_the_visible_surface_is_dropped(depth, kept, seen_again):
    """Within half a percent of its distance it is."""
    point = [0.5 * PIXEL, 0.5 * PIXEL, depth - 4]
    assert (count_at(seen_again([earlier([point])], VIEW, WALL), 24, 24) > 0) == kept
    # From this very position whatever was visible still is.
    assert count_at(seen_again([earlier([point], VIEW.position)], VIEW, WALL), 24, 24) == 2


@pytest.mark.parametrize(
    ("gloss", "degrees", "kept"),
    [
        (DIFFUSE, 60, True),
        (GLOSSY, 7.9, True),
        (GLOSSY, 8.1, False),
        (SPECULAR, 0.19, True),
        (SPECULAR, 0.21, False),
    ],
)
def test_glossy_surfaces_hold_as_long_as_the_direction_of_sight_hardly_turns(
    gloss, degrees, kept, seen_again
):
    new = replace(WALL, gloss=np.full_like(WALL.gloss, gloss))
    # Seen from around the point in the middle, 4 in front of the camera: from its side, and from below.
    turn = np.radians(degrees)
    for x, y in ((1, 0), (0, 1)):
        viewpoint = np.array([4 * x * np.sin(turn), 4 * y * np.sin(turn), -4 * np.cos(turn)])
        found = seen_again([earlier([[0.001, 0.001, 0]], viewpoint, gloss)], VIEW, new)
        assert (count_at(found, 24, 24) > 0) == kept


def test_nothing_else_lands_where_something_specular_is_visible(seen_again):
    gloss = WALL.gloss.copy()
    gloss[24 * SIZE + 24] = SPECULAR
    new = replace(WALL, gloss=gloss)
    points = [[0.5 * PIXEL, 0.5 * PIXEL, 0], [1.5 * PIXEL, 0.5 * PIXEL, 0]]
    found = seen_again([earlier(points)], VIEW, new)
    assert count_at(found, 24, 24) == 0
    assert count_at(found, 24, 25) == 2


def test_a_nearer_sample_hides_those_behind_it_in_its_quarter_of_a_pixel(seen_again):
    """A bar at z = -1 in front of column 24 of the wall: both may be visible there."""
    position = WALL.position.copy().reshape(SIZE, SIZE, 3)
    position[:, 24] = wall(VIEW, -1.0).reshape(SIZE, SIZE, 3)[:, 24]
    new = replace(WALL, position=position.reshape(-1, 3).astype(np.float32))
    near = [
        0.25 * 0.75 * PIXEL,
        0.25 * PIXEL,
        -1.0,
    ]  # upper left quarter of pixel (24, 24), at 3/4 of the distance
    behind = [0.25 * PIXEL, 0.25 * PIXEL, 0.0]  # the same quarter
    beside = [0.75 * PIXEL, 0.25 * PIXEL, 0.0]  # upper right quarter
    assert count_at(seen_again([earlier([behind])], VIEW, new), 24, 24) == 2
    assert count_at(seen_again([earlier([near, behind])], VIEW, new), 24, 24) == 2
    assert count_at(seen_again([earlier([near, beside])], VIEW, new), 24, 24) == 4
    # Nothing hides what was visible from this very position.
    both = [earlier([near]), earlier([behind], VIEW.position)]
    assert count_at(seen_again(both, VIEW, new), 24, 24) == 4


@pytest.mark.parametrize("depth", [-1.0, 1.0], ids=["nearer", "farther"])
@pytest.mark.parametrize("vertical", [True, False])
def test_neighbouring_pixels_tell_which_distances_are_visible(depth, vertical, seen_again):
    """A point at the distance of a bar, or of a slit's ground, holds up to one pixel beside it."""
    position, other = (wall(VIEW, z).reshape(SIZE, SIZE, 3) for z in (0.0, depth))
    bar = np.s_[:, 24] if vertical else np.s_[24]
    position[bar] = other[bar]
    new = replace(WALL, position=position.reshape(-1, 3).astype(np.float32))
    scale = PIXEL * (4 + depth) / 4
    for beside, kept in ((-2, False), (-1, True), (0, True), (1, True), (2, False)):
        across, along = (beside + 0.5) * scale, 0.5 * scale
        point = [across, along, depth] if vertical else [along, across, depth]
        pixel = (24, 24 + beside) if vertical else (24 + beside, 24)
        assert (count_at(seen_again([earlier([point])], VIEW, new), *pixel) > 0) == kept


def test_a_glossy_point_must_lie_on_the_visible_surface_as_well(seen_again):
    new = replace(WALL, gloss=np.full_like(WALL.gloss, GLOSSY))
    behind = [0.5 * PIXEL, 0.5 * PIXEL, 1.0]
    assert not np.array(seen_again([earlier([behind], gloss=GLOSSY)], VIEW, new).records).any()


def view(number: int, size: int, time: float = 0.0) -> PlainView:
    """Samples that tell which view they belong to, and which one of it they are."""
    at = np.stack([np.full(size, number), np.arange(size), np.zeros(size)], axis=1)
    records = np.arange(size * RECORD).reshape(size, RECORD) + 1000 * number
    gloss = (np.arange(size) % 3).astype(np.uint8)
    mover = np.array([STILL, 1, 12_345, UNSTEADY], dtype=np.uint16)[(np.arange(size) + number) % 4]
    viewpoint = np.full(3, float(number))
    return PlainView(records.astype(np.float32), at.astype(np.float32), gloss, mover, viewpoint, time)


def test_samples_stand_in_the_order_in_which_they_came(arrays):
    """Sizes that wrap around the ring and make it grow in between."""
    known = EarlierViews(arrays)
    for number in range(60):
        known.add(view(number, 1 + number * 37 % 900).on(arrays))
        expected = [view(n, 1 + n * 37 % 900) for n in range(max(0, number - MOST_VIEWS + 1), number + 1)]
        index = dr.arange(arrays.plain.UInt, known.samples)
        (position, gloss, view_of, mover), records = known.places(index), known.records(index)
        position = np.stack([side.numpy() for side in position], axis=1)
        np.testing.assert_array_equal(position, np.concatenate([v.position for v in expected]))
        np.testing.assert_array_equal(gloss.numpy(), np.concatenate([v.gloss for v in expected]))
        np.testing.assert_array_equal(mover.numpy(), np.concatenate([v.mover for v in expected]))
        stored = np.stack([column.numpy() for column in records], axis=1)
        np.testing.assert_array_equal(stored, np.concatenate([v.records for v in expected]))
        # The number of a view leads to its viewpoint.
        np.testing.assert_array_equal(known.viewpoints[view_of.numpy()][:, 0], position[:, 0])


def test_cleared_views_are_forgotten(arrays):
    known = EarlierViews(arrays)
    known.add(view(3, 5).on(arrays))
    known.clear()
    assert known.samples == 0
    assert np.isinf(known.viewpoints).all()


def test_views_of_a_few_moments_before_are_kept(arrays):
    """Several views of one moment count as one, and those of the moment that is seen now do not count."""
    known = EarlierViews(arrays)
    for number in range(2 * MOST_MOMENTS):
        for _ in range(2):
            known.moment = Moment(0.1 * (number + 1), np.eye(4)[None, :3])
            known.add(view(number, 5, 0.1 * number).on(arrays))
    assert known.samples == 5 * 2 * MOST_MOMENTS
    assert not known.of_now().any()
    known.moment = Moment(0.1 * (2 * MOST_MOMENTS - 1), np.eye(4)[None, :3])
    assert known.of_now().sum() == 2
