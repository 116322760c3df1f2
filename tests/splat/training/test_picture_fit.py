"""Gaussians fitted to pictures: to look alike where display-encoded values are blended, and in cuts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.image.colour import srgb_from_radiance
from splat.model.gaussians import Blending, Gaussians
from splat.model.hierarchy import Hierarchy, hierarchy_of
from splat.model.trees import static_layer
from splat.raster.cut import HierarchyCut
from splat.raster.differentiable import render_differentiable
from splat.training import picture_fit
from splat.training.gaussian_optimizer import GaussianOptimizer
from splat.training.picture_fit import fitted_for_display, fitted_hierarchy, views_around
from tests.splat.raster.plain_3dgs import picture
from tests.splat.samples import camera, equal, gaussians


@pytest.fixture(autouse=True)
def few_steps(monkeypatch):
    monkeypatch.setattr(picture_fit, "_STEPS", 60)
    monkeypatch.setattr(picture_fit, "_PER_VIEW", 1)


VIEWS = [camera().moved_right(x) for x in (-0.6, -0.2, 0.3, 0.7)]
FOCAL = VIEWS[0].fy


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
    monkeypatch.setattr(picture_fit, "_STEPS", 5)
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


def leaves(degree: int = 1) -> Gaussians:
    g = gaussians("overlap", 200, degree)
    g.log_scales -= 0.8
    return g


def error(arrays, own: Gaussians, hierarchy: Hierarchy) -> float:
    """Mean squared error of coarse cuts in views that are none of VIEWS."""
    nodes, errors = hierarchy.nodes(own), []
    cut = HierarchyCut(arrays, nodes)
    for x in (-0.4, 0.5):
        view = camera().moved_right(x)
        levels = np.full((-(-view.height // 16) + 1, -(-view.width // 16) + 1), 0.05, np.float32)
        factor = cut.least_factor(view, levels, 40)
        index = cut.nodes(view, levels * np.float32(factor), 1.0)[0].torch().long()
        shown = nodes.gaussians.select(index)
        images = [render_differentiable(arrays, g, view) for g in (shown, own)]
        errors.append(float((images[0] - images[1]).square().mean()))
    return float(np.mean(errors))


@pytest.mark.parametrize("degree", [0, 1])
def test_cuts_of_fitted_nodes_are_nearer_to_the_leaves(arrays, degree):
    own, told = leaves(degree), []
    hierarchy = hierarchy_of(static_layer(own))
    found, first, last = fitted_hierarchy(
        arrays, hierarchy, own, FOCAL, VIEWS, 0, 150, lambda *done: told.append(done)
    )
    assert error(arrays, own, found) < 0.9 * error(arrays, own, hierarchy)
    assert last > first
    assert (told[0], told[-1]) == ((1, 150), (150, 150))
    # Pairs and leaves are as they were.
    assert found.children is hierarchy.children
    assert equal(found.nodes(own).gaussians.part(0, len(own)).all_turning(), own)


def test_a_fit_of_levels_repeats_by_its_seed(arrays):
    own = leaves(0)
    hierarchy = hierarchy_of(static_layer(own))
    one, other, third = (
        fitted_hierarchy(arrays, hierarchy, own, FOCAL, VIEWS, seed, 60)[0].inner for seed in (0, 0, 1)
    )
    assert equal(one, other)
    assert not equal(one, third)


def test_nodes_that_a_fit_makes_no_better_stay(arrays, monkeypatch):
    own = leaves(0)
    hierarchy = hierarchy_of(static_layer(own))
    monkeypatch.setattr(GaussianOptimizer, "_between", lambda *given: torch.tensor(0.5))
    found, before, after = fitted_hierarchy(arrays, hierarchy, own, FOCAL, VIEWS, 0, 20)
    assert found is hierarchy
    assert before == after


def test_sizes_of_fitted_nodes_grow_towards_the_roots(arrays):
    own = leaves(0)
    hierarchy = hierarchy_of(static_layer(own))
    inner = hierarchy.nodes(own).gaussians.part(len(own), len(own) + len(hierarchy))
    inner.log_scales[:, ::3] -= 2
    nodes = replace(hierarchy, inner=inner).nodes(own)
    has = nodes.parent >= 0
    assert (nodes.size[nodes.parent[has]] > nodes.size[has]).all()


def test_as_many_nodes_as_pairs(arrays):
    hierarchy = hierarchy_of(static_layer(leaves()))
    with pytest.raises(ValueError, match="pairs and 200 inner nodes"):
        replace(hierarchy, inner=leaves())
