"""The regions of a frame: which pixels they have, and when there is none."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.measure.image_metrics import REGIONS, ImageRegion, plain_regions, regions
from tests import small

# Wider than high, the gaze on the centre of the pixel in row 20 and column 50.
HEIGHT, WIDTH = 40, 100
GAZE = Gaze(50.5 / WIDTH, 20.5 / HEIGHT)
# Radii of 10 and 5 pixels.
FOVEATION = Foveation(GAZE, 25.0, 12.5)


@pytest.fixture
def picture() -> np.ndarray:
    return small.rng().uniform(0.2, 0.8, (HEIGHT, WIDTH, 3)).astype(np.float32)


def test_radii_are_in_percent_of_the_height_around_the_gaze():
    """Pixels at a distance of exactly a radius lie outside it."""
    found = plain_regions(FOVEATION, (HEIGHT, WIDTH))
    assert list(found) == ["whole", "foveal", "seam", "peripheral"]
    row = {name: region.mask[20] for name, region in found.items()}
    assert np.flatnonzero(row["foveal"]).tolist() == list(range(41, 60))
    assert np.flatnonzero(row["seam"]).tolist() == [*range(41, 46), *range(55, 60)]
    assert np.flatnonzero(row["peripheral"]).tolist() == [*range(41), *range(60, 100)]
    assert found["foveal"].mask.sum() == pytest.approx(np.pi * 10**2, rel=0.03)
    assert found["whole"].mask.all()


def test_the_regions_cover_the_frame_once():
    found = plain_regions(FOVEATION, (HEIGHT, WIDTH))
    assert (found["foveal"].mask ^ found["peripheral"].mask).all()
    assert (found["seam"].mask <= found["foveal"].mask).all()


def test_a_box_is_the_smallest_one_around_a_region():
    mask = np.zeros((8, 9), dtype=bool)
    mask[2, 3] = mask[5, 4] = True
    region = ImageRegion.of("foveal", mask)
    assert region.box == (slice(2, 6), slice(3, 5))
    assert plain_regions(FOVEATION, (HEIGHT, WIDTH))["foveal"].box == (slice(11, 30), slice(41, 60))


def test_alone_a_region_shows_the_image_and_nothing_else_of_it(picture):
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[3, 4] = True
    alone = ImageRegion.of("foveal", mask).alone(picture, 2 * picture)
    assert (alone[3, 4] == picture[3, 4]).all()
    alone[3, 4] *= 2
    np.testing.assert_array_equal(alone, 2 * picture)


def test_all_regions_come_in_the_order_of_tables(picture):
    assert tuple(regions(FOVEATION, picture)) == REGIONS


def test_the_salient_fifth_is_where_attention_goes(picture):
    """A bright patch in a dull picture."""
    picture = 0.3 + 0.02 * picture
    picture[8:16, 70:82] = 1.0
    salient = regions(FOVEATION, picture)["salient"].mask
    assert salient.mean() == pytest.approx(0.2, abs=0.02)
    assert salient[8:16, 70:82].all()
    assert not salient[25:, :40].any()


@pytest.mark.parametrize("size", [(130, 200), (64, 64), (200, 70)])
def test_large_and_narrow_frames_have_a_salient_fifth(size):
    found = regions(Foveation(Gaze()), small.rng().uniform(0, 1, (*size, 3)).astype(np.float32))
    assert found["salient"].mask.shape == size
    assert found["salient"].mask.mean() == pytest.approx(0.2, abs=0.05)


def test_regions_that_were_not_asked_for_are_left_out():
    only = plain_regions(FOVEATION, (HEIGHT, WIDTH), ("foveal", "whole"))
    assert list(only) == ["whole", "foveal"]
    # Neither may they be the reason to refuse a frame.
    narrow = Foveation(GAZE, 25.0, 24.99)
    assert list(plain_regions(narrow, (HEIGHT, WIDTH), ("whole", "foveal"))) == ["whole", "foveal"]
    with pytest.raises(UserError, match="the seam region of this frame is empty"):
        plain_regions(narrow, (HEIGHT, WIDTH))


def test_a_seam_of_no_width_and_a_disc_over_the_whole_frame_are_as_asked():
    hard_edge = plain_regions(Foveation(GAZE, 25.0, 25.0), (HEIGHT, WIDTH))
    assert list(hard_edge) == ["whole", "foveal", "peripheral"]
    assert list(plain_regions(Foveation(GAZE, 500.0, 20.0), (HEIGHT, WIDTH))) == ["whole", "foveal"]


def test_regions_that_are_empty_or_unseen_are_named(picture):
    with pytest.raises(UserError, match=r"gaze 1.2 0.5: lies outside the frame"):
        regions(Foveation(Gaze(1.2, 0.5)), picture)
    with pytest.raises(UserError, match="the foveal region of this frame is empty"):
        regions(Foveation(GAZE, 0.0, 0.0), picture)
