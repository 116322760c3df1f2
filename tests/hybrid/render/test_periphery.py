"""The periphery: which layers may be drawn, what the eye resolves, and what is kept for a still camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.eye.detail import CELL
from compose.fovea.foveation import FoveaRegion
from hybrid.measure.image_metrics import psnr
from hybrid.render import periphery as module
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery, ViewSaliency
from splat.lod.forest_renderer import ForestRenderer
from splat.model.dynamic_light import LightCourse

WIDTH, HEIGHT = 96, 80
NONE = FrameSettings(acuity_model="none", fov_a=30, fov_b=20)
GEISLER = replace(NONE, acuity_model="geisler-perry")
# The viewer looks past the frame, about 22 degrees away from it.
PAST = replace(GEISLER, gaze=(-6, -6))


@pytest.fixture(scope="module")
def periphery(arrays, forest) -> Periphery:
    return Periphery(arrays, forest)


@pytest.fixture(scope="module")
def camera(scene):
    return scene.camera.resized(WIDTH, HEIGHT)


def region_of(settings: FrameSettings) -> FoveaRegion:
    return settings.foveation.region(WIDTH, HEIGHT)


NOWHERE = region_of(FrameSettings(fov_a=0, fov_b=0))


def test_all_layers_may_be_drawn_unless_the_settings_limit_them(periphery):
    assert periphery.layers_of(NONE) == (1, 3)
    assert periphery.layers_of(replace(NONE, layers=(2, 3))) == (2, 3)
    assert periphery.layers_of(replace(NONE, layers=(2, 2))) == (2, 2)


@pytest.mark.parametrize("layers", [(0, 1), (1, 4), (3, 2), (-1, -1)])
def test_layers_that_the_forest_does_not_have_are_refused(periphery, camera, layers):
    message = f"layers {layers[0]} {layers[1]}: this forest has layers 1 to 3"
    for use in (periphery.layers_of, lambda settings: periphery.detail(camera, settings)):
        with pytest.raises(UserError, match=message):
            use(replace(NONE, layers=layers))


def test_without_an_acuity_model_the_finest_layer_is_drawn_everywhere(periphery, camera):
    detail = periphery.detail(camera, NONE)
    assert (detail.drawn_level == 3).all()
    assert (detail.drawn_rate == 0).all()
    assert (detail.cutoff == 0.5).all()
    limited = periphery.detail(camera, replace(NONE, layers=(1, 2), rate=2))
    assert (limited.drawn_level == 2).all()
    assert (limited.drawn_rate == 2).all()


def test_no_layer_below_the_coarsest_one_is_drawn(periphery, camera):
    coarse = replace(PAST, acuity_model="fov-gs")
    assert periphery.detail(camera, coarse).drawn_level.min() < 2
    assert periphery.detail(camera, replace(coarse, layers=(2, 3))).drawn_level.min() == 2


def test_detail_falls_with_the_angle_from_the_gaze(periphery, camera, monkeypatch):
    lattice = np.zeros((HEIGHT // CELL + 1, WIDTH // CELL + 1), dtype=np.float32)
    monkeypatch.setattr(ViewSaliency, "of", lambda *_: lattice)
    detail = periphery.detail(camera, PAST)
    # The eye is 1844 pixels away from a desktop: arctan(812.3 / 1844) - arctan(62.5 / 1844).
    assert detail.eccentricity[0, 0] == pytest.approx(21.83, abs=0.01)
    assert detail.eccentricity.argmax() == detail.eccentricity.size - 1
    assert detail.cutoff[0, 0] > detail.cutoff[-1, -1]
    # Everything inside fov-b counts as its edge.
    assert np.ptp(periphery.detail(camera, replace(PAST, gaze=(-2, -2))).cutoff) > 0.05
    wide = replace(PAST, gaze=(-2, -2), fov_a=800, fov_b=800)
    assert np.ptp(periphery.detail(camera, wide).cutoff) < 0.01


@pytest.mark.parametrize(("model", "rate"), [("geisler-perry", 1), ("fov-gs", 2), ("none", 0)])
def test_no_rate_is_finer_than_what_the_layer_was_trained_on(periphery, scene, model, rate):
    """Pixels of training are four pixels of this frame wide; a frequency requires two samples."""
    large = scene.camera.resized(128, 128)
    settings = replace(NONE, acuity_model=model)
    assert periphery.detail(large, settings).steps[0].rate == rate
    # A layer's pixels are twice those of the next one.
    coarser = replace(settings, layers=(1, 2))
    assert periphery.detail(large, coarser).steps[0].rate == (rate + 1 if rate else 0)
    asked = replace(settings, rate=3)
    assert periphery.detail(large, asked).steps[0].rate == 3


def test_saliency_adds_detail_where_an_acuity_model_uses_it(periphery, camera, monkeypatch):
    cutoffs = []
    for value in (0.0, 1.0):
        lattice = np.full((HEIGHT // CELL + 1, WIDTH // CELL + 1), value, dtype=np.float32)
        monkeypatch.setattr(ViewSaliency, "of", lambda *_, lattice=lattice: lattice)
        cutoffs.append(periphery.detail(camera, PAST).cutoff)
    assert (cutoffs[1] >= cutoffs[0]).all()
    assert cutoffs[1][-1, -1] > cutoffs[0][-1, -1]


def test_full_detail_is_the_finest_layer_where_the_fovea_hides_nothing(periphery, camera, arrays, forest):
    drawn = periphery.draw(camera, periphery.detail(camera, NONE), NOWHERE)
    finest = ForestRenderer(arrays, forest).render_layer(camera, 3)
    np.testing.assert_array_equal(drawn.numpy(), finest.numpy())
    np.testing.assert_array_equal(periphery.whole(camera, NONE).numpy(), finest.numpy())
    assert drawn.nodes == finest.nodes > 0


def test_tiles_that_the_fovea_hides_are_not_drawn(periphery, camera):
    settings = replace(NONE, fov_a=60, fov_b=55)
    drawn = periphery.draw(camera, periphery.detail(camera, settings), region_of(settings)).numpy()
    hidden = ~np.kron(region_of(settings).peripheral_tiles(CELL), np.ones((CELL, CELL), dtype=bool))
    assert hidden.any()
    assert (drawn[hidden] == 0).all()
    np.testing.assert_array_equal(drawn[~hidden], periphery.whole(camera, settings).numpy()[~hidden])


def test_the_finest_allowed_layer_is_drawn_as_a_whole(periphery, camera, arrays, forest):
    coarser = ForestRenderer(arrays, forest).render_layer(camera, 2).numpy()
    np.testing.assert_array_equal(periphery.whole(camera, replace(NONE, layers=(1, 2))).numpy(), coarser)
    assert not np.array_equal(coarser, periphery.whole(camera, NONE).numpy())


@pytest.mark.parametrize("layers", [None, (1, 2)])
def test_under_the_disc_the_finest_allowed_layer_is_drawn_at_full_rate(periphery, camera, arrays, layers):
    settings = replace(PAST, gaze=(0.5, 0.5), layers=layers, rate=2, fov_a=20)
    region = region_of(settings)
    detail = periphery.detail(camera, settings)
    alone = periphery.under_disc(camera, settings, region)
    beside, drawn = periphery.draw_with_disc(camera, settings, detail, region)
    np.testing.assert_allclose(beside.numpy(), periphery.draw(camera, detail, region).numpy(), atol=1e-5)
    wanted = np.kron(region.foveal_tiles(CELL), np.ones((CELL, CELL), dtype=bool))
    assert (~wanted).any()
    for under in (alone, drawn):
        found = under.numpy()
        np.testing.assert_allclose(
            found[wanted], periphery.whole(camera, settings).numpy()[wanted], atol=1e-5
        )
        assert (found[~wanted] == 0).all()


def test_for_a_still_camera_the_same_is_drawn_from_kept_layers(periphery, camera):
    region = region_of(NONE)
    detail = periphery.detail(camera, NONE)
    expected = np.array(periphery.draw(camera, detail, region).numpy())
    still, whole = periphery.draw_still(camera, NONE, detail, region)
    np.testing.assert_allclose(still.numpy(), expected, atol=1e-6)
    np.testing.assert_array_equal(whole.numpy(), periphery.whole(camera, NONE).numpy())


@pytest.mark.parametrize("gaze", [(0.1, 0.2), (0.9, 0.5)])
def test_kept_layers_follow_the_gaze(periphery, camera, gaze):
    settings = replace(GEISLER, acuity_model="fov-gs", display="hmd", gaze=gaze, fov_a=0, fov_b=0)
    detail = periphery.detail(camera, settings)
    assert len(detail.steps) > 1
    drawn = np.array(periphery.draw(camera, detail, NOWHERE).numpy())
    still = periphery.draw_still(camera, settings, detail, NOWHERE)[0].numpy()
    elsewhere = periphery.detail(camera, replace(settings, gaze=(1 - gaze[0], 1 - gaze[1])))
    other = np.array(periphery.draw(camera, elsewhere, NOWHERE).numpy())
    assert psnr(still, drawn) > 30
    assert psnr(still, drawn) > psnr(other, drawn) + 3


def test_layers_are_drawn_again_only_when_camera_or_layers_change(arrays, forest, camera, monkeypatch):
    drawn = []

    class Counting(module.CachedLayerImages):
        def __init__(self, renderer, camera, steps):
            drawn.append(steps)
            super().__init__(renderer, camera, steps)

    monkeypatch.setattr(module, "CachedLayerImages", Counting)
    periphery = Periphery(arrays, forest)

    def draw(camera, settings) -> int:
        detail = periphery.detail(camera, settings)
        periphery.draw_still(camera, settings, detail, NOWHERE)
        return len(drawn)

    assert draw(camera, NONE) == 1
    assert draw(replace(camera), replace(NONE, gaze=(0.1, 0.9), spp=3)) == 1
    assert draw(replace(camera, fx=camera.fx * 1.1), NONE) == 2
    assert draw(camera, NONE) == 3
    assert draw(camera, replace(NONE, layers=(1, 2))) == 4
    assert draw(camera, replace(NONE, layers=(1, 2), rate=1)) == 5
    assert [steps[0] for steps in drawn] == [(3, 0), (3, 0), (3, 0), (2, 0), (2, 1)]


FINEST = replace(NONE, level=1e-4)


def test_the_finest_continuous_level_is_the_finest_layer(periphery, camera):
    settings = replace(FINEST, fov_a=0, fov_b=0)
    drawn = periphery.draw(camera, periphery.detail(camera, settings), NOWHERE)
    np.testing.assert_array_equal(drawn.numpy(), periphery.whole(camera, NONE).numpy())


def test_continuous_levels_follow_what_is_resolved(periphery, camera):
    """A level of 2 in as many pixels as the finest detail takes, at the gaze and far away from it."""
    near, far = (
        periphery.detail(camera, replace(GEISLER, level=2.0, gaze=gaze)) for gaze in ((0.5, 0.5), (-6, -6))
    )
    for detail in (near, far):
        np.testing.assert_allclose(detail.levels, 1 / np.maximum(detail.cutoff, 1 / 256), rtol=1e-5)
    assert far.levels.min() > near.levels.max()


def test_fewer_gaussians_are_drawn_where_that_is_asked_for(periphery, camera):
    settings = replace(FINEST, fov_a=0, fov_b=0)
    every = periphery.draw(camera, periphery.detail(camera, settings), NOWHERE)
    few = replace(settings, level=None, gaussians=every.nodes // 4)
    drawn = periphery.draw(camera, periphery.detail(camera, few), NOWHERE)
    assert 0.1 * every.nodes < drawn.nodes <= 0.3 * every.nodes
    assert psnr(drawn.numpy(), every.numpy()) > 15


def test_under_the_disc_lies_everything_whatever_is_left_around_it(periphery, camera):
    settings = replace(NONE, level=4.0, fov_a=60, fov_b=50)
    region, detail = region_of(settings), periphery.detail(camera, settings)
    alone = periphery.under_disc(camera, settings, region).numpy()
    _, under = periphery.draw_with_disc(camera, settings, detail, region)
    whole = periphery.whole(camera, NONE).numpy()
    wanted = np.kron(region.foveal_tiles(CELL), np.ones((CELL, CELL), dtype=bool))
    np.testing.assert_allclose(alone[wanted], whole[wanted], atol=1e-5)
    # Nodes around the disc are large ones, whose tails reach into it.
    inside = np.s_[32:48, 32:64]
    assert psnr(under.numpy()[inside], whole[inside]) > 25


def test_continuous_levels_have_no_layers(periphery, camera):
    with pytest.raises(UserError, match=r"layers .1, 2.: continuous levels of detail have none"):
        periphery.detail(camera, replace(FINEST, layers=(1, 2)))


def test_what_moves_has_no_continuous_levels(arrays, forest, camera):
    light = LightCourse(torch.tensor([0]), torch.ones(2, 3, 1).half())
    lit = Periphery(arrays, replace(forest, light=light))
    with pytest.raises(UserError, match="level, gaussians, level_jod: something moves in the forest of"):
        lit.detail(camera, FINEST)
