"""Complete cuts for a view, against a twin in float64 that walks down the trees."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.camera import camera_from_pose
from splat.model.forest import Forest
from splat.raster.cut import CompleteCuts, HierarchyCut, greatest_factor
from tests.splat.lod.views import flat, frame_camera, overlapping_forest, ramp


@pytest.fixture(scope="module", params=[False, True], ids=["extents", "contrasts"])
def forest(request) -> Forest:
    made = overlapping_forest()
    if not request.param:
        return made
    hierarchy = made.own_hierarchy
    contrast = torch.from_numpy(
        np.random.default_rng(5).lognormal(-4, 0.5, len(hierarchy)).astype(np.float32)
    )
    return replace(made, hierarchy=replace(hierarchy, contrast=contrast))


@pytest.fixture(scope="module")
def cuts(arrays, forest) -> CompleteCuts:
    return CompleteCuts(arrays, forest.hierarchy_nodes)


def looking(yaw: float, height: int = 100):
    """The camera of other tests, turned by degrees."""
    angle = math.radians(yaw)
    pose = np.eye(4)
    pose[:3, :3] = [[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]]
    pose[:3, 3] = [0.1, -0.2, -4]
    return camera_from_pose(pose, 150, height, 120.0, 120.0, 75.0, height / 2)


def twin(forest: Forest, camera, level: float) -> np.ndarray:
    """(M,) by how many octaves nodes are too large for a level that is the same everywhere."""
    nodes = forest.hierarchy_nodes
    means = nodes.gaussians.means.double().numpy().T[nodes.leaves :]
    size, extent, radius = (
        x.astype(np.float64)[nodes.leaves :] for x in (nodes.size, nodes.extent, nodes.radius)
    )
    local = means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    away = np.linalg.norm(local, axis=1)
    half = np.arcsin(np.minimum((radius + 3.33 * extent) / away, 1))
    corner = math.atan(math.hypot(camera.cx / camera.fx, camera.cy / camera.fy))
    beside = np.degrees(np.arccos(local[:, 2] / away) - half - corner) - 4
    near = np.maximum(away - radius, 0.01)
    octaves = np.log2(size * camera.fx / near / level) - np.clip(beside / 4, 0, 6)
    unknown = (away - radius <= 0.01) | ((local[:, 2] <= 0.01) & (beside <= 0))
    return np.where(unknown, np.inf, octaves)


@pytest.mark.parametrize("yaw", [0, 40, 90, 180])
@pytest.mark.parametrize("level", [0.5, 3, 12])
def test_nodes_are_split_where_they_are_too_large(forest, cuts, yaw, level):
    camera, nodes = looking(yaw), forest.hierarchy_nodes
    split, factor = cuts.split(camera, flat(level))
    assert factor == 1
    excess, expected = twin(forest, camera, level), np.zeros(len(split), bool)
    # Parents come after their children.
    for node in reversed(range(len(split))):
        parent = nodes.parent[node + nodes.leaves] - nodes.leaves
        expected[node] = excess[node] > 0 and (parent < 0 or expected[parent])
    doubtful = np.abs(excess) < 1e-3
    assert not (split != expected)[~doubtful].any()


def test_what_lies_behind_is_coarser(cuts):
    ahead, behind = (np.count_nonzero(cuts.split(looking(yaw), flat(1))[0]) for yaw in (0, 180))
    assert behind < ahead / 2


def test_a_limit_draws_so_many_and_the_largest_stay_split(cuts):
    camera = frame_camera()
    free, _ = cuts.split(camera, flat(0.5))
    split, factor = cuts.split(camera, flat(0.5), most=100)
    assert np.count_nonzero(cuts.tree.drawn(split)) == 100
    assert factor > 1
    assert not (split & ~free).any()
    coarse, _ = cuts.split(camera, flat(0.5) * np.float32(factor))
    assert np.count_nonzero(coarse ^ split) <= 1


def test_fewer_than_the_roots_draws_the_roots(cuts):
    split, _ = cuts.split(frame_camera(), flat(0.5), most=1)
    assert not split.any()


def test_most_of_what_was_split_stays(cuts):
    camera = frame_camera()
    before, _ = cuts.split(camera, flat(3))
    # 5 % of a level are within the tenth of an octave that it takes to join nodes again.
    after, _ = cuts.split(camera, flat(3 * 1.05), before=before)
    assert np.array_equal(after, before)
    fresh, _ = cuts.split(camera, flat(3 * 1.05))
    assert np.count_nonzero(fresh) < np.count_nonzero(before)
    for split in (before, after, fresh):
        assert np.array_equal(cuts.tree.closed(split), split)


@pytest.mark.parametrize("focal", [1e-30, 1e30])
def test_a_camera_of_any_numbers_makes_a_cut(cuts, focal):
    camera = replace(frame_camera(), fx=focal, fy=focal)
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = 1e300
    for extreme in (camera, replace(camera, world_to_camera=pose)):
        split, factor = cuts.split(extreme, ramp(1e-3, 1e3), most=100)
        assert np.array_equal(cuts.tree.closed(split), split)
        assert np.isfinite(factor)


def test_held_nodes_are_drawn_as_those_that_levels_choose(arrays, forest, cuts):
    """In the frame, where nothing pops and no two nodes of a line are drawn."""
    camera, levels = frame_camera(), flat(3)
    split, _ = cuts.split(camera, levels)
    free, held = (HierarchyCut(arrays, forest.hierarchy_nodes) for _ in range(2))
    held.hold(cuts.tree.drawn(split))
    (own, turned), (index, same) = (cut.nodes(camera, levels, 1.0) for cut in (free, held))
    assert set(own.numpy()) == set(index.numpy())
    shares = dict(zip(own.numpy(), turned.share.numpy(), strict=True))
    sibling, chosen = forest.hierarchy_nodes.siblings(), cuts.tree.drawn(split)
    assert any(share > 0 for share in shares.values())
    for node, share in zip(index.numpy(), same.share.numpy(), strict=True):
        assert share == pytest.approx(shares[node] if chosen[sibling[node]] else 0, abs=1e-6)


def test_held_nodes_that_are_too_small_turn_into_their_parents(arrays, forest, cuts):
    """A cut that is late is drawn as coarse as it should be, and one that is too coarse as it is."""
    camera = frame_camera()
    cut = HierarchyCut(arrays, forest.hierarchy_nodes)
    cut.hold(cuts.tree.drawn(np.ones(cuts.tree.inner, bool)))
    index, turned = cut.nodes(camera, flat(50), 1.0)
    assert (index.numpy() < forest.hierarchy_nodes.leaves).all()
    siblings = forest.hierarchy_nodes.siblings()[index.numpy()] < forest.hierarchy_nodes.leaves
    assert (turned.share.numpy()[siblings] == 1).mean() > 0.9
    cut.hold(cuts.tree.drawn(np.zeros(cuts.tree.inner, bool)))
    index, turned = cut.nodes(camera, flat(0.01), 1.0)
    assert (turned.share.numpy() == 0).all()
    assert len(index) == cuts.tree.roots


def test_what_cuts_make_visible_is_summed_up_for_all_factors(arrays, forest):
    """As in cuts of those levels, in float64; differences of what lies beside the frame do not count."""
    camera, nodes, rng = frame_camera(), forest.hierarchy_nodes, np.random.default_rng(8)
    cut, levels, weights = HierarchyCut(arrays, nodes), flat(0.25), ramp(0.2, 3)
    visibility = np.float32(rng.lognormal(-8, 1, len(nodes.size)))
    visibility[: nodes.leaves] = 0
    sums = cut.differences(camera, levels, arrays.plain.Float(visibility), weights)
    expected = np.zeros(321)
    for step in range(321):
        index = cut.nodes(camera, levels * np.float32(2 ** (step / 32)), 1.0)[0].numpy()
        means = nodes.gaussians.means.double().numpy().T[index]
        ahead = np.linalg.norm(means - camera.position, axis=1) - nodes.radius[index]
        pixels, _ = camera.project(means)
        u, v = (np.clip(pixels / 16, 0, np.array(weights.shape)[::-1] - 1.001)).T
        column, row = u.astype(int), v.astype(int)
        above, below = (
            weights[r, column] * (1 - u + column) + weights[r, column + 1] * (u - column)
            for r in (row, row + 1)
        )
        weight = above * (1 - v + row) + below * (v - row)
        size = nodes.extent[index] * max(camera.fx, camera.fy) / np.maximum(ahead, 0.01)
        values = np.where(ahead > 0.01, visibility[index] * size**4 * weight, 0)
        expected[step] = values.sum()
    # Parents may show less than their children do together.
    np.testing.assert_allclose(sums, np.maximum.accumulate(expected), rtol=2e-3)


def test_the_greatest_factor_shows_no_more_than_is_allowed():
    sums = np.array([1.0, 1, 2, 4, 4, 8])
    found = [32 * math.log2(greatest_factor(sums, most)) for most in (0.5, 1, 1.5, 2, 3, 4, 6, 8, 9)]
    assert found == pytest.approx([0, 1, 1.5, 2, 2.5, 4, 4.5, 5, 5])
