"""The quality of levels of detail, learnt from what FovVideoVDP says of pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.eye.display import Display
from hybrid.measure.perceptual_metrics import difference_map, has_fovvideovdp, jod
from hybrid.preparation import level_judging as module
from hybrid.preparation.level_judging import Judged, judged_quality
from splat.model.forest import Forest
from splat.training.picture_fit import CutViews
from tests.splat.lod.views import frame_camera, overlapping_forest

needs_metric = pytest.mark.skipif(not has_fovvideovdp(), reason="FovVideoVDP is not installed")
DISPLAY = Display(128, 96, 12.0)


def pictures(noise: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    expected = np.float32(0.3 + 0.4 * rng.random((48, 64, 3)))
    return np.clip(expected + np.float32(noise * rng.normal(size=expected.shape)), 0, 1), expected


@needs_metric
def test_what_is_visible_grows_with_the_difference_and_towards_the_gaze():
    def total(noise: float, eccentricity: float) -> float:
        return float(difference_map(*pictures(noise), DISPLAY, eccentricity).sum())

    found = difference_map(*pictures(0.05), DISPLAY, 10.0)
    assert found.shape == (48, 64)
    assert (found >= 0).all()
    assert total(0, 10) == 0
    assert total(0.02, 10) < total(0.05, 10) < total(0.1, 10)
    assert total(0.05, 30) < total(0.05, 10) < total(0.05, 0)


@needs_metric
def test_what_is_visible_lies_where_pictures_differ():
    shown, expected = pictures(0.05)
    shown[:, :32] = expected[:, :32]
    found = difference_map(shown, expected, DISPLAY, 10.0)
    assert found[:, 36:].mean() > 20 * found[:, :16].mean()


@needs_metric
def test_the_metric_stays_as_it_is():
    one, other = pictures(0.05)
    before = jod(one, other, DISPLAY, module.Gaze())
    difference_map(one, other, DISPLAY, 10.0)
    assert jod(one, other, DISPLAY, module.Gaze()) == before


def test_a_law_is_found_again():
    visible = np.geomspace(1e-4, 1, 12)
    rows = [Judged(n % 3, float(v), float(10 - 1.5 * v**0.4)) for n, v in enumerate(visible)]
    scale, exponent = module._law(rows)
    assert (scale, exponent) == pytest.approx((1.5, 0.4))
    # Nothing is lost where nothing can be seen.
    assert module._law([Judged(0, 1.0, 10.0)]) == (0.0, module._USUAL_EXPONENT)


@needs_metric
def test_quality_is_learnt_and_repeats_by_its_seed(arrays, monkeypatch):
    monkeypatch.setattr(module, "_VIEWS", 3)
    made = overlapping_forest()
    forest: Forest = replace(made, hierarchy=made.own_hierarchy)
    views = CutViews(arrays, forest.finest, 120.0, [frame_camera().moved_right(x) for x in (-0.5, 0, 0.5)])
    told: list[tuple[int, int]] = []
    one, error = judged_quality(views, forest, DISPLAY, 1, 30, lambda *now: told.append(now))
    again, same = judged_quality(views, forest, DISPLAY, 1, 30)
    assert told == [(n, 45) for n in range(1, 46)]
    assert one.display == DISPLAY
    assert len(one.visibility) == len(forest.hierarchy)
    assert (one.visibility > 0).all()
    assert one.scale * one.exponent > 0
    assert error < 1
    assert (one.scale, one.exponent, error) == (again.scale, again.exponent, same)
