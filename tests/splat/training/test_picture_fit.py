"""Gaussians fitted to pictures: to look alike where display-encoded values are blended, and in cuts."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch

from compose.image.colour import srgb_from_radiance
from splat.model.gaussians import SH_DC, Blending, Gaussians
from splat.model.hierarchy import USUAL_CONTRAST, CutTree, Hierarchy, hierarchy_of
from splat.model.trees import static_layer
from splat.raster.cut import HierarchyCut
from splat.raster.differentiable import render_differentiable
from splat.training import picture_fit
from splat.training.gaussian_optimizer import GaussianOptimizer
from splat.training.picture_fit import CutViews, fitted_for_display, fitted_hierarchy, views_around
from tests.splat.raster.plain_3dgs import picture
from tests.splat.raster.reference import double, render
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
    """Mean squared error of coarse cuts, display-encoded, in views that are none of VIEWS."""
    nodes, errors = hierarchy.nodes(own), []
    cut = HierarchyCut(arrays, nodes)
    for x, most in product((-0.4, 0.5), (25, 40, 60, 90)):
        view = camera().moved_right(x)
        levels = np.full((-(-view.height // 16) + 1, -(-view.width // 16) + 1), 0.05, np.float32)
        factor = cut.least_factor(view, levels, most)
        index = cut.nodes(view, levels * np.float32(factor), 1.0)[0].torch().long()
        shown = nodes.gaussians.select(index)
        one, other = (
            srgb_from_radiance(render_differentiable(arrays, g, view).numpy()) for g in (shown, own)
        )
        errors.append(float(np.square(one - other).mean()))
    return float(np.mean(errors))


@pytest.mark.parametrize("degree", [0, 1])
def test_cuts_of_fitted_nodes_are_nearer_to_the_leaves(arrays, degree):
    own, told = leaves(degree), []
    hierarchy = hierarchy_of(static_layer(own))
    found, first, last = fitted_hierarchy(
        CutViews(arrays, own, FOCAL, VIEWS), hierarchy, 0, 150, lambda *done: told.append(done)
    )
    assert error(arrays, own, found) < 0.9 * error(arrays, own, hierarchy)
    assert last > first
    assert told == [(k, 300) for k in range(1, 301)]
    # Pairs and leaves are as they were.
    assert found.children is hierarchy.children
    assert equal(found.nodes(own).gaussians.part(0, len(own)).all_turning(), own)


def test_a_fit_of_levels_repeats_by_its_seed(arrays):
    own = leaves(0)
    hierarchy = hierarchy_of(static_layer(own))
    one, other, third = (
        fitted_hierarchy(CutViews(arrays, own, FOCAL, VIEWS), hierarchy, seed, 60)[0] for seed in (0, 0, 1)
    )
    assert equal(one.inner, other.inner)
    assert torch.equal(one.contrast, other.contrast)
    assert not equal(one.inner, third.inner)
    assert not torch.equal(one.contrast, third.contrast)


def test_nodes_that_a_fit_makes_no_better_stay(arrays, monkeypatch):
    own = leaves(0)
    hierarchy = hierarchy_of(static_layer(own))
    monkeypatch.setattr(GaussianOptimizer, "_between", lambda *given: torch.tensor(0.5))
    found, before, after = fitted_hierarchy(CutViews(arrays, own, FOCAL, VIEWS), hierarchy, 0, 20)
    assert found.inner is None
    assert found.children is hierarchy.children
    assert before == after


@pytest.mark.parametrize("blending", list(Blending))
def test_errors_are_shared_by_weights(arrays, blending):
    """Those of plain twins, in which one Gaussian at a time is white and all others are black."""
    own = replace(gaussians("overlap", 12, degree=1), blending=blending)
    values = torch.from_numpy(np.random.default_rng(2).random((36, 40)).astype(np.float32))
    expected = []
    for number in range(len(own)):
        is_white = torch.arange(len(own)) == number
        alone = replace(
            own, sh=torch.where(is_white, 0.5 / SH_DC, -0.5 / SH_DC).expand(1, 3, -1).contiguous()
        )
        shown = (
            picture(alone, camera()) if blending is Blending.DISPLAY else render(double(alone), camera(), 0.1)
        )
        expected.append(float((shown[..., 0] * values).sum()))
    found = picture_fit._shares(arrays, own, camera(), 0.1, values).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)


def striped(n: int = 400) -> Gaussians:
    """Small Gaussians on a plane: those on the left are grey, those on the right black or white."""
    rng = np.random.default_rng(4)
    means = np.stack([*rng.uniform(-1.2, 1.2, (2, n)), np.zeros(n)])
    sh = np.where(means[0] < 0, 0.0, rng.choice([-1.5, 1.5], n))
    return Gaussians(
        torch.from_numpy(np.float32(means)),
        torch.full((3, n), -2.6) + torch.tensor([[0.0], [0.0], [-3.0]]),
        torch.tensor([[1.0], [0], [0], [0]]).repeat(1, n),
        torch.full((n,), 1.0),
        torch.from_numpy(np.float32(sh)).expand(1, 3, -1).contiguous(),
    )


def test_nodes_that_hide_something_are_drawn_last(arrays):
    own = striped()
    hierarchy = hierarchy_of(static_layer(own))
    found, _, _ = fitted_hierarchy(CutViews(arrays, own, FOCAL, VIEWS), hierarchy, 0, 200)
    nodes = found.nodes(own)
    x, small = nodes.gaussians.means[0, len(own) :].numpy(), nodes.extent[len(own) :] < 0.3
    grey, mixed = (np.median(found.contrast.numpy()[small & side]) for side in (x < -0.2, x > 0.2))
    assert mixed > 3 * grey
    # As many nodes are nearer to the leaves than those that extents alone choose.
    assert error(arrays, own, found) < 0.9 * error(arrays, own, replace(found, contrast=None))


def test_contrasts_are_of_what_was_seen_and_of_what_lies_above():
    """Against a plain walk down the trees."""
    rng = np.random.default_rng(6)
    hierarchy = hierarchy_of(static_layer(leaves(0)))
    tree, count = CutTree(hierarchy.parents(200), 200), len(hierarchy)
    seen = rng.integers(0, 4, count).astype(np.float64)
    areas = np.where(seen > 0, seen * rng.lognormal(3, 1, count), 0)
    errors = areas * rng.lognormal(-4, 2, count)
    usual, density = errors.sum() / areas.sum(), {count: errors.sum() / areas.sum()}
    for node in reversed(range(count)):
        once = areas[node] / seen[node] if seen[node] else 1.0
        above = density[int(tree.above[200 + node])]
        density[node] = (errors[node] + once * above) / (areas[node] + once)
    expected = np.maximum([density[node] for node in range(count)], 1e-4 * usual)
    found = picture_fit._over_powers(tree, errors, areas, seen)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_where_nothing_is_hidden_extents_count(arrays):
    """Two black Gaussians in one place, in black."""
    own = replace(leaves(0), sh=torch.full((1, 3, 200), -2.0))
    hierarchy = hierarchy_of(static_layer(own))
    found, _, _ = fitted_hierarchy(CutViews(arrays, own, FOCAL, VIEWS), hierarchy, 0, 8)
    assert (found.contrast == USUAL_CONTRAST).all()


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
    with pytest.raises(ValueError, match=r"pairs and contrasts of shape \(3,\)"):
        replace(hierarchy, contrast=torch.ones(3))
