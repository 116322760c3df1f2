"""The picture of the parents' shares in a fused fovea."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from compose.image.colour import bytes_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.render.false_colours import weights_picture

pytestmark = pytest.mark.usefixtures("backend")
REGION = Foveation(Gaze(), 30, 20).region(32, 24)


def frame_of(weights):
    """A frame with shares (D, 4) of the parents, or none."""
    arrays = device_arrays()
    disc = REGION.disc(arrays)
    shares = None if weights is None else [arrays.plain.Float(share.copy()) for share in weights.T]
    fovea = SimpleNamespace(weights=shares, disc=disc)
    composite = np.full((24, 32, 3), (1.0, 0.0, 0.2), dtype=np.float32)
    return SimpleNamespace(composite=composite, region=REGION, fovea=fovea, of_disc=disc.frame_image)


@pytest.mark.parametrize(
    ("shares", "colour"),
    [
        ((1, 0, 0, 0), (255, 0, 0)),
        ((0, 1, 0, 0), (0, 255, 0)),
        ((0, 0, 1, 0), (120, 190, 255)),
        ((0, 0, 0, 1), (0, 0, 255)),
        ((0.5, 0.3, 0, 0.2), (128, 77, 51)),
        # Rounding in the softmax leaves 0..1.
        ((1.001, -0.001, 0, 0), (255, 0, 0)),
    ],
)
def test_shares_are_red_green_light_blue_and_blue(shares, colour):
    picture = weights_picture(frame_of(np.tile(np.float32(shares), (REGION.count, 1))))
    assert picture.shape == (24, 32, 3)
    assert picture.dtype == np.uint8
    assert (picture.reshape(-1, 3)[REGION.pixels] == colour).all()


def test_each_pixel_shows_its_own_shares():
    weights = np.zeros((REGION.count, 4), dtype=np.float32)
    weights[:, 0] = np.linspace(0, 1, REGION.count)
    weights[:, 3] = 1 - weights[:, 0]
    picture = weights_picture(frame_of(weights))
    found = picture.reshape(-1, 3)[REGION.pixels]
    np.testing.assert_allclose(found, weights[:, [0, 1, 3]] * 255, atol=0.5)


def test_outside_the_disc_the_frame_is_dark_and_grey():
    frame = frame_of(np.zeros((REGION.count, 4), dtype=np.float32))
    outside = REGION.weight_image() == 0
    found = weights_picture(frame)[outside]
    # Red 255, no green, blue 124: 0.4 times their mean.
    assert bytes_from_radiance(frame.composite)[0, 0].tolist() == [255, 0, 124]
    assert (found == round(0.4 * (255 + 124) / 3)).all()


def test_a_fovea_that_is_not_fused_has_no_weights():
    with pytest.raises(ValueError, match="only a fused fovea has weights"):
        weights_picture(frame_of(None))
