"""The octree over hits, against one that is built cell by cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.gaussians import SH_DC
from splat.model.trees import Layer
from splat.training import clusters
from splat.training.clusters import HitTree
from splat.training.initialization import hits_of
from tests.splat.training.frames import WALLS, closed_sphere

DEPTH = 6


@pytest.fixture(autouse=True)
def shallow(monkeypatch):
    """A tree that can be built by hand."""
    monkeypatch.setattr(clusters, "_DEPTH", DEPTH)


def own_leaves(hits: Layer, worth: float) -> list[set[int]]:
    """Leaves as sets of hits, in float64, without any sums over ranges."""
    points = hits.gaussians.means.T.double().numpy()
    colour = np.minimum((0.5 + SH_DC * hits.gaussians.sh[0]).T.double().numpy(), clusters._BRIGHTEST)
    pixel = hits.gaussians.log_scales[0].double().exp().numpy()
    low = points.min(axis=0)
    cell = ((points - low) / (points - low).max() * (2**DEPTH - 1)).astype(int)
    found: list[set[int]] = []

    def divide(members: np.ndarray, depth: int) -> None:
        size = np.sqrt(((points[members] - points[members].mean(axis=0)) ** 2).sum(axis=1).mean())
        size *= np.sqrt((pixel[members] ** -2.0).mean())
        spread = ((colour[members] - colour[members].mean(axis=0)) ** 2).sum()
        if depth == DEPTH or len(members) < 4 or (size <= clusters._LARGEST and spread <= worth):
            found.append(set(members.tolist()))
            return
        keys = cell[members] >> (DEPTH - depth - 1)
        for key in np.unique(keys, axis=0):
            divide(members[(keys == key).all(axis=1)], depth + 1)

    for kind in np.unique(clusters._kind(hits)):
        divide(np.flatnonzero(clusters._kind(hits) == kind), 0)
    return found


def tree_leaves(tree: HitTree, order: np.ndarray, worth: float) -> list[set[int]]:
    first = tree._leaves(worth)
    return [set(part.tolist()) for part in np.split(order, first[1:])]


@pytest.mark.parametrize("views", [WALLS, [closed_sphere(0.0), closed_sphere(0.1)]], ids=["wall", "sphere"])
@pytest.mark.parametrize("worth", [0.02, 0.3, 5.0])
def test_leaves_are_those_of_an_octree_built_cell_by_cell(views, worth, monkeypatch):
    # Large enough that none of these is drawn in.
    monkeypatch.setattr(clusters, "_FAR", 1e6)
    hits = hits_of(views)
    # Each hit names itself.
    hits.parent[:] = torch.arange(len(hits))
    tree = HitTree(hits)
    found = tree_leaves(tree, tree._hits.parent.numpy(), worth)
    expected = own_leaves(hits, worth)
    assert sorted(map(min, found)) == sorted(map(min, expected))
    assert sorted(map(sorted, found)) == sorted(map(sorted, expected))
    assert tree.count_of(worth) == len(expected)


def test_as_many_leaves_as_asked_for_or_a_few_less():
    tree = HitTree(hits_of(WALLS))
    for count in (50, 200, 600):
        assert 0.9 * count <= len(tree.seeds(count, np.random.default_rng(0))) <= count


def test_further_leaves_leave_less_error():
    """As stated: the mean squared difference from the leaves' own colours."""
    hits = hits_of([replace(view, radiance=np.minimum(view.radiance, 0.9)) for view in WALLS])
    tree = HitTree(hits)
    stated = [tree.psnr_of(count) for count in (50, 200, 800)]
    assert stated == sorted(stated)
    seeds = tree.seeds(200, np.random.default_rng(0))
    first = tree._leaves(tree.worth_of(200))
    shown = np.repeat(seeds.gaussians.sh[0].numpy().T, np.diff(first, append=len(hits)), axis=0)
    own = tree._hits.gaussians.sh[0].numpy().T
    error = np.mean((SH_DC * (shown - own)) ** 2)
    assert stated[1] == pytest.approx(-10 * np.log10(error), abs=0.05)


def test_seeds_are_hits():
    """One of each leaf, in the mean colour of all of them."""
    hits = hits_of(WALLS)
    seeds = HitTree(hits).seeds(100, np.random.default_rng(0))
    where = {tuple(point) for point in hits.gaussians.means.T.tolist()}
    assert all(tuple(point) in where for point in seeds.gaussians.means.T.tolist())
    few = HitTree(hits).seeds(1, np.random.default_rng(0))
    torch.testing.assert_close(few.gaussians.sh[0, :, 0], hits.gaussians.sh[0].double().mean(dim=1).float())


def test_detail_gets_the_seeds():
    """A wall that is plain but for a quarter of it."""
    view = WALLS[0]
    radiance = np.full_like(view.radiance, 0.4)
    radiance[:16, :16] = view.radiance[:16, :16] * np.random.default_rng(0).uniform(0, 2, (16, 16, 1))
    shown = replace(view, radiance=radiance)
    seeds = HitTree(hits_of([shown])).seeds(150, np.random.default_rng(0))
    position, _ = view.camera.project(seeds.gaussians.means.T.double().numpy())
    assert (position < 16).all(axis=1).mean() > 0.6


def test_labels_are_not_mixed():
    view = replace(WALLS[0], instance=np.full(WALLS[0].distance.shape, -1, np.int32))
    view.instance[:, ::2] = 0
    hits = hits_of([view])
    hits.semantic[:] = torch.from_numpy(view.instance.ravel())
    hits.parent[:] = torch.arange(len(hits))
    tree = HitTree(hits)
    for leaf in tree_leaves(tree, tree._hits.parent.numpy(), 1e9):
        assert len(set(hits.semantic[list(leaf)].tolist())) == 1


def test_without_hits_there_is_no_tree():
    empty = replace(WALLS[0], distance=np.full_like(WALLS[0].distance, np.inf))
    with pytest.raises(ValueError, match="at least one hit"):
        HitTree(hits_of([empty]))
