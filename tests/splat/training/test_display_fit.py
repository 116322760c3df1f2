"""Gaussians fitted to look alike where display-encoded values are blended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.image.colour import srgb_from_radiance
from splat.model.gaussians import Blending, Gaussians
from splat.raster.differentiable import render_differentiable
from splat.training import display_fit
from splat.training.display_fit import fitted_for_display, views_around
from tests.splat.raster.plain_3dgs import picture
from tests.splat.samples import camera, equal, gaussians


@pytest.fixture(autouse=True)
def few_steps(monkeypatch):
    monkeypatch.setattr(display_fit, "_STEPS", 60)
    monkeypatch.setattr(display_fit, "_PER_VIEW", 1)


VIEWS = [camera().moved_right(x) for x in (-0.6, -0.2, 0.3, 0.7)]


def psnr(arrays, found: Gaussians, own: Gaussians) -> float:
    """Of pictures by the twin in views that are none of VIEWS."""
    errors = []
    for x in (-0.4, 0.5):
        view = replace(camera().moved_right(x), cx=20.0, cy=18.0)
        expected = srgb_from_radiance(render_differentiable(arrays, own, view).numpy())
        errors.append(np.square(picture(found, view).clamp(0, 1).numpy() - expected).mean())
    return float(-10 * np.log10(np.mean(errors)))


def test_fitted_gaussians_look_alike_in_unseen_views(arrays):
    own, done = gaussians("overlap", 80, degree=1), []
    found, said = fitted_for_display(arrays, own, 48.0, VIEWS, 0, lambda *now: done.append(now))
    assert found.blending is Blending.DISPLAY
    assert done == [(k, 60) for k in range(1, 61)]
    before, after = psnr(arrays, own, own), psnr(arrays, found, own)
    assert after > max(before + 8, 35)
    assert said == pytest.approx(after, abs=5)


def test_a_fit_repeats_by_its_seed(arrays, monkeypatch):
    monkeypatch.setattr(display_fit, "_STEPS", 5)
    own = gaussians("overlap", 30, degree=0)
    first, again, other = (fitted_for_display(arrays, own, 48.0, VIEWS, seed)[0] for seed in (0, 0, 1))
    assert equal(first, again)
    assert not equal(first, other)
    assert first.degree == 0


def test_what_no_view_shows_stays_as_it_is(arrays):
    own = gaussians("overlap", 20, degree=1)
    own.means[2] = -100
    found, said = fitted_for_display(arrays, own, 48.0, VIEWS, 0)
    assert equal(found, own)
    assert said == np.inf


def test_views_are_made_up_where_none_are_known(arrays):
    own = gaussians("overlap", 50)
    views = views_around(own, 40.0, 0)
    assert {view.fy for view in views} == {40.0}
    shown = [view.shows(own.means.T.double().numpy())[1].sum() for view in views]
    assert np.mean(shown) > 10
    # A single Gaussian, and all in one place, are seen as well.
    assert len(views_around(replace(own, means=torch.zeros(3, 50)), 40.0, 0)) == len(views)
