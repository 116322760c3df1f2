"""Compositing of hand-made atlases: what is linear stays so, and weights mix by what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splat.lod.compositing import composite
from splat.lod.layer_images import AtlasEntry, LayerImage, SplatImage
from tests.splat.lod.views import CELLS, CORNERS, HEIGHT, WIDTH, everything, frame_camera, ramp

STRIDE = 160


def entry(rate: int, top: int, weight: np.ndarray, cells: np.ndarray | None = None) -> AtlasEntry:
    cells = everything() if cells is None else cells
    return AtlasEntry(LayerImage(1, rate, weight), top, np.ones((1, 1), bool), cells)


def samples(rate: int, a: float, b: float, c: float) -> np.ndarray:
    """(rows, STRIDE, 4) samples of the plane a x + b y + c, with y and its negative as further channels."""
    side = 1 << rate
    rows = -(-HEIGHT // side)
    y, x = np.meshgrid(side * (np.arange(rows) + 0.5), side * (np.arange(STRIDE) + 0.5), indexing="ij")
    plane = a * x + b * y + c
    return np.stack([plane, y, -plane, np.full_like(plane, 99.0)], axis=-1).astype(np.float32)


def composited(arrays, entries: list[AtlasEntry], blocks: list[np.ndarray]) -> np.ndarray:
    """The frame of an atlas that consists of blocks of samples one above the other."""
    atlas = np.concatenate(blocks)
    flat = arrays.plain.Float(atlas.ravel())
    image = SplatImage(arrays, flat, STRIDE, len(atlas), STRIDE, 4, nodes=5)
    frame = composite(arrays, entries, image, frame_camera())
    assert (frame.width, frame.height, frame.channels, frame.nodes) == (WIDTH, HEIGHT, 3, 5)
    return frame.numpy()


def pixels() -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)


@pytest.mark.parametrize("rate", [0, 1, 2, 3, 4])
def test_linear_images_are_interpolated_exactly(arrays, rate):
    """Except at the border, where pixels beyond the last sample's centre take its value."""
    frame = composited(arrays, [entry(rate, 0, ramp(1, 1))], [samples(rate, 0.5, -0.25, 3.0)])
    x, y = pixels()
    side = 1 << rate
    # Outer samples' centres in the frame.
    last_x, last_y = ((-(-n // side) - 0.5) * side for n in (WIDTH, HEIGHT))
    x, y = np.clip(x, side / 2, last_x), np.clip(y, side / 2, last_y)
    plane = 0.5 * x - 0.25 * y + 3
    np.testing.assert_allclose(frame, np.stack([plane, y, -plane], axis=-1), atol=1e-3)


@pytest.mark.parametrize("rates", [(0, 0), (0, 1), (2, 0), (3, 3), (1, 4)])
def test_weights_mix_two_images(arrays, rates):
    """Constant images of 1 and 10 under a weight that rises from left to right and from top to bottom."""
    rise = ramp(0, 0.5) + np.linspace(0, 0.5, CORNERS[0], dtype=np.float32)[:, None]
    first, second = (samples(rate, 0, 0, value) for rate, value in zip(rates, (1.0, 10.0), strict=True))
    entries = [entry(rates[0], 0, 1 - rise), entry(rates[1], len(first), rise)]
    frame = composited(arrays, entries, [first, second])
    x, y = pixels()
    weight = 0.5 * x / (16 * CELLS[1]) + 0.5 * y / (16 * CELLS[0])
    np.testing.assert_allclose(frame[..., 0], 1 + 9 * weight, atol=1e-4)


def test_cells_show_the_entries_that_cover_them(arrays):
    """Left the first image alone, right the second, nothing in the middle."""
    left, right = (np.zeros(CELLS, dtype=bool) for _ in range(2))
    left[:, :3], right[:, 6:] = True, True
    first, second = samples(0, 0, 0, 1.0), samples(1, 0, 0, 2.0)
    entries = [entry(0, 0, ramp(1, 1), left), entry(1, len(first), ramp(1, 1), right)]
    frame = composited(arrays, entries, [first, second])[..., 0]
    assert (frame[:, :48] == 1).all()
    assert (frame[:, 48:96] == 0).all()
    assert (frame[:, 96:] == 2).all()


def test_a_single_entry_is_shown_whatever_its_weight(arrays):
    """Where only one image is left, its weight is 1 up to rounding and not looked at."""
    frame = composited(arrays, [entry(0, 0, ramp(0.5, 0.5))], [samples(0, 0, 0, 4.0)])
    assert (frame[..., 0] == 4).all()


def test_images_are_found_at_their_first_row(arrays):
    """Three images at one rate; each cell shows two of them, in other combinations from left to right."""
    blocks = [samples(0, 0, 0, value) for value in (1.0, 2.0, 4.0)]
    cells = [np.zeros(CELLS, dtype=bool) for _ in range(3)]
    for number, columns in enumerate(((0, 1, 2, 3), (0, 1, 2, 6, 7, 8, 9), (3, 4, 5, 6, 7, 8, 9))):
        cells[number][:, list(columns)] = True
    half = ramp(0.5, 0.5)
    entries = [entry(0, k * HEIGHT, half, cells[k]) for k in range(3)]
    frame = composited(arrays, entries, blocks)[50, :, 0]
    assert frame[8] == 1.5
    assert frame[3 * 16 + 8] == 2.5
    assert frame[4 * 16 + 8] == 4
    assert frame[7 * 16 + 8] == 3


def test_more_entries_than_a_word_has_bits(arrays):
    """Forty images of 1, 2, ...: each cell shows one of them, and the first one with another half each."""
    blocks = [samples(2, 0, 0, float(k + 1)) for k in range(40)]
    cells = [np.zeros(CELLS, dtype=bool) for _ in blocks]
    for number in range(40):
        cells[number].flat[number + 1] = True
    cells[7].flat[0] = cells[39].flat[0] = True
    half = ramp(0.5, 0.5)
    entries = [entry(2, k * len(blocks[0]), half, cells[k]) for k in range(40)]
    frame = composited(arrays, entries, blocks)[::16, ::16, 0].ravel()
    assert frame[0] == 0.5 * (8 + 40)
    assert frame[1:41].tolist() == [float(k + 1) for k in range(40)]


@pytest.mark.parametrize("rate", [0, 2])
def test_infinite_samples_show_where_they_are_alone(arrays, rate):
    block = samples(rate, 0, 0, 1.0)
    block[3, 4] = np.inf
    frame = composited(arrays, [entry(rate, 0, ramp(1, 1))], [block])[..., 0]
    bright = frame > 1
    side = 1 << rate
    assert bright[3 * side : 4 * side, 4 * side : 5 * side].all()
    assert not np.isnan(frame).any()
    assert (frame[~bright] == 1).all()
    assert bright.sum() <= (3 * side) ** 2


def test_other_frames_share_the_kernels_values(arrays):
    """A frame of another size from the same samples has the same pixels."""
    block = samples(1, 0.5, 0.25, 1.0)
    whole = composited(arrays, [entry(1, 0, ramp(1, 1))], [block])
    image = SplatImage(arrays, arrays.plain.Float(block.ravel()), STRIDE, len(block), STRIDE, 4, nodes=5)
    camera = replace(frame_camera(), width=64, height=48)
    weight = np.ones((4, 5), np.float32)
    small = composite(arrays, [entry(1, 0, weight, np.ones((3, 4), bool))], image, camera).numpy()
    assert small.shape == (48, 64, 3)
    # The last pixel lies beyond the last sample inside the smaller frame.
    np.testing.assert_array_equal(small[:47, :63], whole[:47, :63])
