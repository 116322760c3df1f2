"""What is learnt of the quality of levels of detail: the law, what forests carry of it, and what is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS, Display
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.level_quality import LevelQuality, attach_quality, quality_of, weights_at
from hybrid.render.periphery import Periphery
from splat.io.forest_file import load_forest, save_forest
from splat.model.forest import Forest
from tests.splat.lod.views import frame_camera, overlapping_forest

SETTINGS = FrameSettings(fov_a=0, fov_b=0, level_jod=9.0)


@pytest.fixture(scope="module")
def forest() -> Forest:
    made = overlapping_forest()
    made = replace(made, hierarchy=made.own_hierarchy)
    visibility = torch.from_numpy(np.random.default_rng(1).lognormal(-6, 1, len(made.hierarchy)))
    return attach_quality(made, LevelQuality(visibility.float(), 2.0, 0.4, DISPLAYS["desktop"]))


def nodes(periphery: Periphery, settings: FrameSettings) -> int:
    camera = frame_camera()
    region = settings.foveation.region(camera.width, camera.height)
    return periphery.draw(camera, periphery.detail(camera, settings), region).nodes


def test_the_law_goes_both_ways_and_falls_with_quality():
    quality = LevelQuality(torch.ones(3), 1.7, 0.45, DISPLAYS["desktop"])
    jods = np.linspace(5, 9.99, 100)
    most = np.array([quality.most(jod) for jod in jods])
    np.testing.assert_allclose([quality.jod(visible) for visible in most], jods, rtol=1e-12)
    assert (np.diff(most) < 0).all()
    assert (np.diff(weights_at(np.linspace(0, 60, 100, dtype=np.float32))) < 0).all()


def test_what_a_forest_has_learnt_comes_back(forest, tmp_path):
    save_forest(tmp_path / "f", forest)
    back, own = quality_of(load_forest(tmp_path / "f")), quality_of(forest)
    assert torch.equal(back.visibility, own.visibility)
    assert (back.scale, back.exponent, back.display) == (2.0, 0.4, DISPLAYS["desktop"])
    assert quality_of(overlapping_forest()) is None
    assert quality_of(attach_quality(forest, None)) is None


@pytest.mark.parametrize("focal", [1e-30, 1e30])
@pytest.mark.parametrize("scale", [0.0, 1e-30, 1e30])
def test_any_camera_and_law_make_levels(arrays, forest, focal, scale):
    camera, quality = frame_camera(), quality_of(forest)
    periphery = Periphery(arrays, attach_quality(forest, replace(quality, scale=scale)))
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = 1e300
    for extreme in (replace(camera, fx=focal, fy=focal), replace(camera, world_to_camera=pose)):
        assert np.isfinite(periphery.detail(extreme, SETTINGS).levels).all()


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("visibility", lambda t: t[1:]),
        ("visibility", lambda t: -t),
        ("visibility", lambda t: t * np.inf),
        ("visibility", torch.Tensor.double),
        ("law", lambda t: t[1:]),
        ("law", lambda t: -t),
        ("law", torch.Tensor.float),
        ("law", lambda t: t * np.nan),
    ],
)
def test_damage_is_named(forest, name, change):
    key = f"about.levels.{name}"
    damaged = replace(forest, attached={**forest.attached, key: change(forest.attached[key])})
    with pytest.raises(UserError, match="the quality of the forest's levels is damaged; run hybrid levels"):
        quality_of(damaged)


def test_the_better_the_more_is_drawn_and_never_more_than_is_visible(arrays, forest):
    periphery, camera, counts = Periphery(arrays, forest), frame_camera(), []
    for jod in np.linspace(6, 9.95, 8):
        settings = replace(SETTINGS, level_jod=float(jod))
        counts.append(nodes(periphery, settings))
        detail = periphery.detail(camera, settings)
        # Between two steps of the factor, some nodes have changed already.
        below = detail.levels * np.float32(2 ** (-1.01 / 32))
        visible = periphery.visible(camera, detail, below, quality_of(forest))[0]
        assert quality_of(forest).jod(visible) >= jod - 1e-3
    assert counts == sorted(counts)
    assert counts[-1] > 1.5 * counts[0]


def test_levels_never_rise_with_quality(arrays, forest):
    """Over 10,000 pairs of quality and place in the frame, up to 40 degrees from the gaze."""
    periphery, camera = Periphery(arrays, forest), frame_camera()
    unseen = replace(SETTINGS, acuity_model="geisler-perry", gaze=(-4.0, 0.5))
    levels = []
    for jod in np.linspace(4, 9.99, 100):
        detail = periphery.detail(camera, replace(unseen, level_jod=float(jod)))
        levels.append(detail.levels.ravel())
    assert (np.diff(levels, axis=0) <= 1e-6 * np.max(levels)).all()


def test_of_a_number_and_a_quality_the_coarser_levels_hold(arrays, forest):
    periphery = Periphery(arrays, forest)
    alone = nodes(periphery, SETTINGS)
    assert nodes(periphery, replace(SETTINGS, gaussians=10**6)) == alone
    assert nodes(periphery, replace(SETTINGS, gaussians=alone // 2)) <= alone // 2 + 2


def test_what_is_not_known_is_said(arrays, forest):
    camera = frame_camera()
    with pytest.raises(UserError, match="does not know how good its levels look; run hybrid levels"):
        Periphery(arrays, overlapping_forest()).detail(camera, SETTINGS)
    other = replace(SETTINGS, display=Display(800, 600, 40.0))
    with pytest.raises(UserError, match=r"the levels were judged for Display\(width=1920"):
        Periphery(arrays, forest).detail(camera, other)
