"""The picture of levels, rates and eccentricity."""

from __future__ import annotations

import numpy as np
import pytest

from compose.eye.acuity import Step
from compose.eye.detail import DetailMap
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from compose.image.colour import bytes_from_radiance
from hybrid.render.false_colours import detail_picture, levels_picture
from tests import small

WIDTH, HEIGHT = 128, 64
NOWHERE = Foveation(Gaze(), 0, 0).region(WIDTH, HEIGHT)


def detail_of(layer: int, rate: int, eccentricity: np.ndarray | float = 5.0) -> DetailMap:
    """One of three layers at one rate, in the whole frame."""
    return mixed([Step(0.0, layer, rate)], 0.0, eccentricity)


def mixed(steps: list[Step], index: np.ndarray | float, eccentricity: np.ndarray | float = 5.0) -> DetailMap:
    """Steps at the corners of cells, by index."""
    corners = (HEIGHT // 16 + 1, WIDTH // 16 + 1)
    full = [np.full(corners, value, dtype=np.float32) for value in (eccentricity, 0.5, index)]
    return DetailMap(WIDTH, HEIGHT, 3, full[0], full[1], full[1], tuple(steps), full[2])


def noise(seed: int = 0) -> np.ndarray:
    return small.rng(seed).uniform(0, 1, (HEIGHT, WIDTH, 3)).astype(np.float32)


def grey(value: float) -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), value, dtype=np.float32)


@pytest.mark.parametrize(
    ("layer", "expected"),
    [
        # Half of the grey 255 and half of the layer's colour, from red (230, 70, 40) to blue (40, 110, 240).
        (1, (242, 162, 147)),
        (2, (195, 172, 197)),
        (3, (147, 182, 247)),
    ],
)
def test_layers_run_from_red_to_blue(layer, expected):
    picture = levels_picture(grey(1.0), detail_of(layer, 0), NOWHERE)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    assert picture.dtype == np.uint8
    assert (picture == expected).all()


def test_black_keeps_some_of_the_colour():
    picture = levels_picture(grey(0.0), detail_of(1, 0), NOWHERE)
    # Half of 0.4 times the colour.
    assert (picture == (46, 14, 8)).all()


def test_a_single_layer_is_shown_in_one_colour():
    corners = np.zeros((HEIGHT // 16 + 1, WIDTH // 16 + 1), dtype=np.float32)
    only = DetailMap(WIDTH, HEIGHT, 1, corners, corners, corners, (Step(0.0, 1, 0),), corners)
    assert len(np.unique(levels_picture(grey(1.0), only, NOWHERE).reshape(-1, 3), axis=0)) == 1


def test_what_is_path_traced_alone_keeps_its_colours():
    region = Foveation(Gaze(), 40, 20).region(WIDTH, HEIGHT)
    frame = noise()
    picture = levels_picture(frame, detail_of(1, 0), region)
    inside = region.weight_image() >= 1
    assert inside.any()
    np.testing.assert_array_equal(picture[inside], bytes_from_radiance(frame)[inside])
    tinted = levels_picture(frame, detail_of(1, 0), NOWHERE)
    np.testing.assert_array_equal(picture[~inside], tinted[~inside])


@pytest.mark.parametrize("rate", [0, 1, 3])
def test_below_the_full_rate_samples_are_shown_as_blocks(rate):
    frame, size = noise(), 2**rate
    picture = levels_picture(frame, detail_of(2, rate), NOWHERE).astype(int)
    blocks = picture.reshape(HEIGHT // size, size, WIDTH // size, size, 3)
    assert (blocks == blocks[:, :1, :, :1]).all()
    half = picture.reshape(HEIGHT // (2 * size), 2 * size, WIDTH // (2 * size), 2 * size, 3)
    assert (half != half[:, :1, :, :1]).any()
    # Noise that is averaged keeps its mean.
    full = levels_picture(frame, detail_of(2, 0), NOWHERE)
    assert picture.mean() == pytest.approx(full.mean(), abs=1)


def test_blocks_at_the_edge_are_means_of_what_is_there():
    width, height = 90, 50
    frame = np.zeros((height, width, 3), dtype=np.float32)
    frame[:, :80] = 1
    corners = np.zeros((5, 7), dtype=np.float32)
    detail = DetailMap(width, height, 3, corners, corners, corners, (Step(0.0, 2, 4),), corners)
    nowhere = Foveation(Gaze(), 0, 0).region(width, height)
    picture = levels_picture(frame, detail, nowhere)
    assert picture.shape == (height, width, 3)
    # Columns 80 to 89 are a block of their own, black up to its padded edge.
    assert (picture[:, 80:] == picture[0, 80]).all()
    assert (picture[:, :80] == picture[0, 0]).all()
    assert picture[0, 0].sum() > picture[0, 80].sum()


def test_white_rings_mark_every_ten_degrees():
    across = np.linspace(0, 32, WIDTH // 16 + 1)[None, :].repeat(HEIGHT // 16 + 1, axis=0)
    picture = levels_picture(grey(0.1), detail_of(2, 0, across), NOWHERE)
    # A quarter of a degree per pixel: pixel n has its centre at (n + 0.5) / 4 degrees.
    white = (picture == 255).all(axis=2)
    assert (white == white[0]).all()
    assert np.flatnonzero(white[0]).tolist() == [40, 80, 120]
    down = np.linspace(0, 16, HEIGHT // 16 + 1)[:, None].repeat(WIDTH // 16 + 1, axis=1)
    white = (levels_picture(grey(0.1), detail_of(2, 0, down), NOWHERE) == 255).all(axis=2)
    assert np.flatnonzero(white[:, 5]).tolist() == [40]


def test_black_lines_separate_rates():
    """From rate 0 on the left to rate 2 on the right, and from layer 3 to layer 2 at the same rate."""
    steps = [Step(0.0, 3, 0), Step(1.0, 3, 1), Step(2.0, 2, 1), Step(3.0, 2, 2)]
    index = np.array([0, 0, 1, 1, 2, 2, 3, 3, 3], dtype=np.float32)[None, :].repeat(5, axis=0)
    picture = levels_picture(grey(1.0), mixed(steps, index), NOWHERE)
    black = (picture == 0).all(axis=2)
    assert (black == black[0]).all()
    # Rates change half-way between columns 16 and 32, and between 80 and 96.
    assert np.flatnonzero(black[0]).tolist() == [24, 88]
    rows = np.array([0, 0, 1, 1, 1], dtype=np.float32)[:, None].repeat(9, axis=1)
    black = (levels_picture(grey(1.0), mixed(steps, rows), NOWHERE) == 0).all(axis=2)
    assert np.flatnonzero(black[:, 3]).tolist() == [24]


def test_the_legend_lies_below_the_picture():
    detail = detail_of(2, 1)
    picture = detail_picture(noise(), detail, NOWHERE)
    np.testing.assert_array_equal(picture[:HEIGHT], levels_picture(noise(), detail, NOWHERE))
    legend = picture[HEIGHT:]
    assert legend.shape[1] == WIDTH
    colours = {tuple(colour) for colour in legend.reshape(-1, 3).tolist()}
    # At this size only the first layers fit beside each other.
    assert {(255, 255, 255), (230, 70, 40), (135, 90, 140)} <= colours
    assert (legend == 255).mean() > 0.4
    # A box of 12 pixels per layer with its name beside it, and a line of text below.
    dark = (legend < 100).all(axis=2)
    assert (legend[6:19, 6:19] == (230, 70, 40)).all()
    assert not dark[:20, :21].any()
    assert dark[6:20, 21:40].any()
    assert not dark[20:, :6].any()
    assert dark[20:34, 6:20].any()
