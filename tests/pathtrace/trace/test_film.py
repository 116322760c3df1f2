"""Film positions, rays through them, and their samples: lanes, sequences and counts."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from compose.base.arrays import uploaded
from compose.base.traced_samples import Counts
from compose.camera.camera import camera_from_pose, look_at
from pathtrace.trace.film import (
    FILM,
    LIGHT,
    SCATTERING,
    FilmPositions,
    Lanes,
    Sequences,
    box_positions,
    fractional_counts,
    frame_positions,
    interleaved,
    opaque_camera,
    pixel_positions,
    ray_through,
    sobol_tables,
)
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def corners(positions: FilmPositions) -> list[tuple[float, float]]:
    return list(zip(positions.x.numpy().tolist(), positions.y.numpy().tolist(), strict=True))


def test_a_pixels_corner_is_its_column_and_row():
    positions = pixel_positions(mi.UInt32([0, 4, 5, 13]), width=5)
    assert corners(positions) == [(0, 0), (4, 0), (0, 1), (3, 2)]
    assert (positions.count, positions.width, positions.height) == (4, 1, 1)


def test_a_frame_is_all_pixels_row_by_row(tmp_path):
    from pathtrace.scene.scene import load_scene

    camera = load_scene(small.furnace()).camera.resized(3, 2)
    assert corners(frame_positions(camera)) == [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)]


def test_boxes_have_sizes_of_their_own():
    left, top, width, height = np.array([[0.5, 2.25], [3, 4], [1, 2], [0.5, 8]])
    positions = box_positions(left, top, width, height)
    assert corners(positions) == [(0.5, 3), (2.25, 4)]
    assert positions.width.numpy().tolist() == [1, 2]
    assert positions.height.numpy().tolist() == [0.5, 8]


def test_channels_are_interleaved():
    found = interleaved([mi.Float([1, 2]), mi.Float([3, 4]), mi.Float([5, 6])])
    assert found.dtype == np.float32
    assert found.tolist() == [[1, 3, 5], [2, 4, 6]]


def test_whole_numbers_need_no_array():
    assert fractional_counts(4, 10, 0) == 4
    assert fractional_counts(3.0, 10, 0) == 3


@pytest.mark.parametrize(
    ("spp", "few", "many"), [(2.3, 70, 30), (1.5, 50, 50), (6.99, 1, 99), (1.001, 100, 0)]
)
def test_the_mean_is_met_by_the_numbers_below_and_above(spp, few, many):
    counts = fractional_counts(spp, 100, seed=5)
    below = int(spp)
    assert counts.dtype == np.int64
    assert [int((counts == below).sum()), int((counts == below + 1).sum())] == [few, many]


def test_every_position_gets_the_larger_number_equally_often():
    runs = np.array([fractional_counts(1.25, 16, seed) for seed in range(400)]) - 1
    assert np.array_equal(fractional_counts(1.25, 16, 3), fractional_counts(1.25, 16, 3))
    # Binomial with 400 draws of 1 / 4: standard deviation 8.7 around 100.
    assert (np.abs(runs.sum(axis=0) - 100) < 4 * 8.7).all()


def test_rays_agree_with_the_cameras():
    """A turned camera with unequal focal lengths and its principal point off the centre."""
    pose = look_at(np.array([1.0, 2, 3]), np.array([-2.0, 0.5, 7]), np.array([0.1, 1, 0.2]))
    camera = camera_from_pose(pose, 40, 30, 35.0, 28.0, 17.0, 19.5)
    pixels = small.rng().uniform(-10, 50, (200, 2))
    ray = ray_through(opaque_camera(camera), *(mi.Float(values) for values in pixels.T))
    directions = np.array(ray.d).T
    np.testing.assert_allclose(directions, camera.rays(pixels), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(np.array(ray.o).ravel(), [1, 2, 3], rtol=1e-6)


def test_points_on_a_ray_project_to_its_pixel():
    pose = look_at(np.zeros(3), np.array([0.3, 0.1, 1]), np.array([0.0, 1, 0]))
    camera = camera_from_pose(pose, 64, 48, 50.0, 50.0, 32.0, 24.0)
    ray = ray_through(opaque_camera(camera), mi.Float([3.25, 60.5]), mi.Float([40.0, 0.125]))
    pixels, depth = camera.project(np.array(ray(7.0)).T.astype(np.float64))
    np.testing.assert_allclose(pixels, [[3.25, 40], [60.5, 0.125]], atol=1e-3)
    assert (depth > 0).all()


COUNT = 500


def counts_of(each) -> Counts:
    """Numbers of samples that differ from position to position."""
    return Counts.of(uploaded(mi.UInt32, np.asarray(each, dtype=np.uint32)), int(np.max(each)))


def row_of_boxes(row: float = 7) -> FilmPositions:
    """COUNT pixels side by side."""
    return FilmPositions(mi.Float(np.arange(COUNT, dtype=np.float32)), mi.Float(np.full(COUNT, row)))


def sample_positions(lanes: Lanes, boxes: FilmPositions, offset, pattern):
    """Film coordinates of the lanes' samples."""
    return lanes.sample_positions(boxes, lanes.sequences(boxes, offset, pattern))


def samples(spp, offset=0, pattern: int = 1, row: float = 7) -> np.ndarray:
    """(COUNT, spp, 2) sample positions relative to their boxes."""
    lanes = Lanes.of(COUNT, spp)
    x, y = sample_positions(lanes, row_of_boxes(row), mi.UInt32(offset), mi.UInt32(pattern))
    used = slice(0, lanes.count)
    index = lanes.index.numpy()[used]
    return np.stack([x.numpy()[used] - index, y.numpy()[used] - row], axis=-1).reshape(COUNT, -1, 2)


def test_lanes_of_equal_counts():
    lanes = Lanes.of(3, 2)
    assert lanes.count == 6
    assert lanes.index.numpy()[:6].tolist() == [0, 0, 1, 1, 2, 2]
    assert lanes.sample.numpy()[:6].tolist() == [0, 1, 0, 1, 0, 1]
    assert lanes.first.numpy().tolist() == [0, 2, 4]


def test_lanes_of_different_counts():
    lanes = Lanes.of(4, counts_of([2, 0, 1, 3]))
    assert lanes.count == 6
    assert lanes.index.numpy()[:6].tolist() == [0, 0, 2, 3, 3, 3]
    assert lanes.sample.numpy()[:6].tolist() == [0, 1, 0, 0, 1, 2]
    assert lanes.first.numpy()[[0, 2, 3]].tolist() == [0, 2, 3]


def test_other_counts_compile_nothing_again():
    """Their number, which differs from frame to frame, is no part of a kernel."""
    for seed in range(3):
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            lanes = Lanes.of(COUNT, counts_of(small.rng(seed).integers(0, 4, COUNT)))
            dr.eval(lanes.sample)
        kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(kernel["cache_hit"] and not kernel["cache_disk"] for kernel in kernels)


def noise(lanes: Lanes, channels: int = 6) -> list[np.ndarray]:
    """Channels of values of very different size, one per lane, padding included."""
    return list(np.exp(small.rng().normal(0, 4, (channels, len(lanes.active)))).astype(np.float32))


def summed(lanes: Lanes, channels: list[np.ndarray]) -> np.ndarray:
    """(C, N) sums of channels."""
    return np.stack([total.numpy() for total in lanes.sums([mi.Float(channel) for channel in channels])])


def expected_sums(spp: np.ndarray, channels: list[np.ndarray]) -> np.ndarray:
    """(C, N) sums in float64."""
    ends = np.cumsum(spp)
    runs = list(zip(ends - spp, ends, strict=True))
    return np.array([[channel[a:b].sum(dtype=np.float64) for a, b in runs] for channel in channels])


@pytest.mark.parametrize("spp", [1, 2, 7, 16])
def test_sums_of_equal_counts(spp):
    lanes = Lanes.of(COUNT, spp)
    values = noise(lanes)
    expected = expected_sums(np.full(COUNT, spp), values)
    np.testing.assert_allclose(summed(lanes, values), expected, rtol=1e-6)


def test_sums_of_different_counts():
    """As exact as float32 can be; positions without a sample have the sum 0, the first and last ones too."""
    counts = small.rng().integers(0, 70, COUNT)
    counts[[0, 1, 20, 21, -1]] = 0
    lanes = Lanes.of(COUNT, counts_of(counts))
    values = noise(lanes)
    found = summed(lanes, values)
    np.testing.assert_allclose(found, expected_sums(counts, values), rtol=1e-7)
    assert (found[:, counts == 0] == 0).all()
    np.testing.assert_array_equal(found, summed(lanes, values))
    # However many channels there are.
    np.testing.assert_array_equal(found[2:3], summed(lanes, values[2:3]))


def test_the_sum_of_one_very_large_count_beside_small_ones():
    """In float32, small samples would be lost beside the large sum of those before them."""
    counts = small.rng().integers(0, 3, COUNT)
    counts[100] = 1 << 17
    lanes = Lanes.of(COUNT, counts_of(counts))
    values = [np.full(len(lanes.active), value, dtype=np.float32) for value in (0.1, 3.3)]
    np.testing.assert_allclose(summed(lanes, values), expected_sums(counts, values), rtol=1e-7)


@pytest.mark.parametrize("value", [np.inf, 3e38])
def test_a_positions_samples_do_not_touch_other_sums(value):
    """The square of a very bright sample is infinite; and beside it, other samples would vanish."""
    counts = np.array([2, 3, 0, 2])
    lanes = Lanes.of(4, counts_of(counts))
    values = np.ones(len(lanes.active), dtype=np.float32)
    values[3] = value
    assert summed(lanes, [values]).tolist() == [[2, np.float32(value), 0, 2]]


@pytest.mark.parametrize(("positions", "spp", "width"), [(3, 2, 4096), (4096, 1, 4096), (4097, 1, 8192)])
def test_lanes_are_padded_with_inactive_ones(positions, spp, width):
    """A frozen function is not recorded again as long as the width stays a multiple of 4096."""
    for counts in (spp, counts_of(np.full(positions, spp))):
        active = Lanes.of(positions, counts).active.numpy()
        assert len(active) == width
        assert active[: positions * spp].all()
        assert not active[positions * spp :].any()


def test_sums_are_over_each_positions_samples():
    channel = mi.Float(np.concatenate([[1, 2, 4, 8, 16, 32], np.full(4090, 1000.0)]))
    assert Lanes.of(3, 2).sums([channel])[0].numpy().tolist() == [3, 12, 48]
    assert Lanes.of(6, 1).sums([channel])[0].numpy().tolist() == [1, 2, 4, 8, 16, 32]
    assert Lanes.of(5, counts_of([2, 0, 1, 3, 0])).sums([channel])[0].numpy().tolist() == [3, 0, 4, 56, 0]


@pytest.mark.parametrize("spp", [2, 4, 16])
def test_every_column_and_row_of_a_box_gets_one_sample(spp):
    strata = np.sort(np.floor(samples(spp) * spp), axis=1)
    assert (strata == np.arange(spp)[None, :, None]).all()


def test_every_cell_of_a_box_gets_one_sample():
    """The first 16 points of a Sobol sequence fill a grid of 4 x 4."""
    cells = np.floor(samples(16) * 4)
    assert (np.sort(cells[..., 0] * 4 + cells[..., 1], axis=1) == np.arange(16)).all()


def test_later_samples_fill_the_gaps_between_earlier_ones():
    both = np.concatenate([samples(4), samples(4, offset=4)], axis=1)
    np.testing.assert_array_equal(both, samples(8))
    assert (np.sort(np.floor(both * 8), axis=1) == np.arange(8)[None, :, None]).all()


def test_each_position_may_have_its_own_offset():
    offsets = small.rng().integers(0, 6, COUNT).astype(np.uint32)
    expected = samples(8)[np.arange(COUNT)[:, None], offsets[:, None] + np.arange(2)]
    np.testing.assert_array_equal(samples(2, offset=offsets), expected)


def test_first_samples_are_uniform_over_all_boxes():
    """Each box's first sample is uniform: the estimate of any one sample is unbiased."""
    first = samples(1)[:, 0]
    counts = np.histogram2d(first[:, 0], first[:, 1], bins=5, range=[[0, 1], [0, 1]])[0]
    expected = COUNT / 25
    # Chi-squared with 24 degrees of freedom: 0.999 quantile.
    assert ((counts - expected) ** 2 / expected).sum() < 51.2


@pytest.mark.parametrize("other", [{"pattern": 2}, {"row": 8}])
def test_other_patterns_and_boxes_are_scrambled_independently(other):
    one, two = samples(1)[:, 0], samples(1, **other)[:, 0]
    for axis in (0, 1):
        # Uncorrelated: standard deviation 1 / sqrt(500) = 0.045.
        assert abs(np.corrcoef(one[:, axis], two[:, axis])[0, 1]) < 4 * 0.045


def test_a_boxs_samples_do_not_depend_on_the_other_boxes():
    pixels = np.array([17, 3, 400], dtype=np.float32)
    lanes = Lanes.of(3, 4)
    boxes = FilmPositions(mi.Float(pixels), mi.Float([7, 7, 7]))
    x, _ = sample_positions(lanes, boxes, mi.UInt32(0), mi.UInt32(1))
    found = x.numpy()[:12].reshape(3, 4) - pixels[:, None]
    np.testing.assert_array_equal(found, samples(4)[pixels.astype(int), :, 0])


def test_numbers_of_samples_may_differ():
    counts = small.rng().integers(0, 5, COUNT)
    lanes = Lanes.of(COUNT, counts_of(counts))
    x, _ = sample_positions(lanes, row_of_boxes(), mi.UInt32(0), mi.UInt32(1))
    found = (x.numpy() - lanes.index.numpy())[: lanes.count]
    even = samples(4)[..., 0]
    np.testing.assert_array_equal(found, np.concatenate([even[i, :n] for i, n in enumerate(counts)]))


def test_a_sequence_that_ends_restarts_scrambled_otherwise():
    restarted = samples(4, offset=4096)
    assert not np.array_equal(restarted, samples(4))
    assert (np.sort(np.floor(restarted * 4), axis=1) == np.arange(4)[None, :, None]).all()
    across = samples(2, offset=4095)
    np.testing.assert_array_equal(across[:, 1], restarted[:, 0])


def test_samples_fill_boxes_of_any_size():
    left = np.arange(COUNT, dtype=np.float32) * 3
    width = small.rng().uniform(0.25, 3, COUNT).astype(np.float32)
    boxes = box_positions(left, np.full(COUNT, 2.0), width, np.full(COUNT, 0.5))
    lanes = Lanes.of(COUNT, 4)
    x, y = sample_positions(lanes, boxes, mi.UInt32(0), mi.UInt32(1))
    index = lanes.index.numpy()[: lanes.count]
    inside = (x.numpy()[: lanes.count] - left[index]) / width[index]
    # Far from 0, float32 is coarser than the quarters of narrow boxes are exact.
    quarters = np.sort(np.floor(inside.reshape(COUNT, 4) * 4 + 1e-3), axis=1)
    assert (quarters == np.arange(4)).mean() > 0.99
    assert (inside > -1e-3).all()
    assert (inside < 1 + 1e-3).all()
    rows = (y.numpy()[: lanes.count] - 2) / 0.5
    assert (np.sort(np.floor(rows.reshape(COUNT, 4) * 4), axis=1) == np.arange(4)).all()


def points(pair: int, count: int, one: int = 3, other: int = 5, start: int = 0) -> np.ndarray:
    """(2, count) points of one sequence, from a number on."""
    number = dr.arange(mi.UInt32, count) + start
    sequences = Sequences(sobol_tables(), number, (mi.UInt32(one), mi.UInt32(other)))
    x, y = sequences.point(pair, number)
    return np.stack([x.numpy(), y.numpy()])


def first_points(pair: int, count: int) -> np.ndarray:
    """(2, count) first points of as many sequences."""
    sequences = Sequences(sobol_tables(), mi.UInt32(0), (dr.arange(mi.UInt32, count), mi.UInt32(7)))
    x, y = sequences.point(pair, dr.zeros(mi.UInt32, count))
    return np.stack([x.numpy(), y.numpy()])


@pytest.mark.parametrize("pair", [FILM, LIGHT, SCATTERING])
def test_each_of_n_strata_has_one_of_n_points(pair):
    x, y = points(pair, 256)
    for values in (x, y):
        assert sorted((values * 256).astype(int)) == list(range(256))


@pytest.mark.parametrize("pair", [FILM, LIGHT, SCATTERING])
def test_scrambled_points_are_uniform(pair):
    first = first_points(pair, 2000)
    for values in first:
        assert stats.kstest(values, "uniform").pvalue > 1e-3


def test_pairs_scramblings_and_restarts_differ():
    drawn = [
        points(FILM, 16),
        points(LIGHT, 16),
        points(SCATTERING, 16),
        points(FILM, 16, 4),
        points(FILM, 16, start=4096),
    ]
    for index, one in enumerate(drawn):
        for other in drawn[:index]:
            assert (one != other).all()


def test_film_and_lights_are_not_related():
    film = first_points(FILM, 2000)
    light = first_points(LIGHT, 2000)
    for one in film:
        for other in light:
            assert abs(stats.pearsonr(one, other).statistic) < 0.1
