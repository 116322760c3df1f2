"""The nodes that a camera sees: all of those, from near to far, and projected once per camera."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
import torch

from splat.lod.footprints import ForestFootprints
from splat.model.forest import Forest, forest_of
from splat.model.trees import static_layer
from splat.raster.projection import PIXEL_FILTER, camera_numbers, footprints
from tests.splat.lod.views import frame_camera, small_forest
from tests.splat.raster.splats import parameters_from
from tests.splat.samples import gaussians

FIELDS = ("x", "y", "xx", "xy", "yy", "conditional", "opacity", "red", "green", "blue", "depth")


def spread_forest(degree: int) -> Forest:
    """One layer, much of it beside or behind the camera."""
    g = gaussians("off-screen", 300, degree)
    g.means[2] *= 4
    return forest_of([static_layer(g)], 120.0, "", "")


def projected(arrays, forest: Forest, camera) -> dict[str, np.ndarray]:
    """All nodes of the finest layer, in the forest's order."""
    raw = footprints(parameters_from(arrays, forest.finest), camera_numbers(arrays, camera))
    return {name: dr.detach(getattr(raw, name), preserve_type=False).numpy() for name in FIELDS}


def all_of(arrays, cache: ForestFootprints, part: range):
    return cache.records.at(dr.arange(arrays.plain.UInt, len(part)) + part.start)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_footprints_are_those_of_the_projection(arrays, degree):
    """Whatever the length of a node's record, every number comes from its place."""
    forest, camera = spread_forest(degree), frame_camera()
    cache = ForestFootprints(arrays, forest)
    (layer,) = cache.layers(camera, 1.0, [1])
    found = all_of(arrays, cache, layer)
    every = projected(arrays, forest, camera)
    # The depth tells which node a footprint is of.
    node = np.abs(found.depth.numpy()[:, None] - every["depth"]).argmin(axis=1)
    assert len(set(node.tolist())) == len(node)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(found, name).numpy(), every[name][node], rtol=1e-5, atol=1e-6)
    assert (np.diff(found.depth.numpy()) >= -1e-4).all()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("every", [1, 3, 1000])
def test_nodes_of_which_some_turn_look_as_if_the_others_had_harmonics_of_zero(arrays, degree, every):
    forest, camera = spread_forest(degree), frame_camera()
    own = forest.nodes.gaussians.turning(torch.arange(300) % every == every // 2)
    found = []
    for gaussians_of in (own, own.all_turning()):
        changed = replace(forest, nodes=replace(forest.nodes, gaussians=gaussians_of))
        cache = ForestFootprints(arrays, changed)
        (layer,) = cache.layers(camera, 1.0, [1])
        found.append(all_of(arrays, cache, layer))
    for name in FIELDS:
        np.testing.assert_allclose(
            *(getattr(one, name).numpy() for one in found), rtol=1e-4, atol=1e-6, err_msg=name
        )


@pytest.mark.parametrize("blur", [1.0, 30.0])
def test_no_node_that_shows_is_left_out(arrays, blur):
    """A node shows where its alpha under the widest filter reaches 1/255 in the frame."""
    forest, camera = spread_forest(0), frame_camera()
    cache = ForestFootprints(arrays, forest)
    (layer,) = cache.layers(camera, blur, [1])
    raw = projected(arrays, forest, camera)
    extent = 2 * np.log(np.maximum(raw["opacity"] * 255, 1))
    reach_x, reach_y = (np.sqrt(extent * (raw[name] + PIXEL_FILTER * blur**2)) for name in ("xx", "yy"))
    shows = (raw["opacity"] > 1 / 255) & (raw["x"] + reach_x > 0) & (raw["x"] - reach_x < camera.width)
    shows &= (raw["y"] + reach_y > 0) & (raw["y"] - reach_y < camera.height)
    kept = set(all_of(arrays, cache, layer).x.numpy().tolist())
    assert set(raw["x"][shows].tolist()) <= kept
    assert 0 < shows.sum() <= len(kept) < len(forest.finest)


def test_layers_follow_one_another(arrays):
    """Each layer's footprints are those that it has alone, also where others are added later."""
    forest, camera = small_forest(), frame_camera()
    cache = ForestFootprints(arrays, forest)
    early = cache.layers(camera, 4.0, [3, 1])
    layers = cache.layers(camera, 4.0, [2, 3, 1])
    assert layers[1:] == early
    assert sorted(n for part in layers for n in part) == list(range(sum(map(len, layers))))
    for number, part in zip([2, 3, 1], layers, strict=True):
        alone = ForestFootprints(arrays, forest)
        expected = all_of(arrays, alone, *alone.layers(camera, 4.0, [number]))
        np.testing.assert_array_equal(all_of(arrays, cache, part).x.numpy(), expected.x.numpy())


@pytest.fixture
def cache_and_projected(arrays, monkeypatch):
    """A cache, and the numbers of the layers that it has projected."""
    cache, layers = ForestFootprints(arrays, small_forest()), []
    visible = cache._visible
    monkeypatch.setattr(
        cache, "_visible", lambda camera, n, blur: layers.append(n) or visible(camera, n, blur)
    )
    return cache, layers


def test_a_camera_is_projected_once(cache_and_projected):
    (cache, projected_layers), camera = cache_and_projected, frame_camera()
    # The filter's width is rounded up to a power of two: 4.
    for view, blur, count in (
        (camera, 3.0, 1),
        (replace(camera), 1.0, 1),
        (camera, 4.0, 1),
        (camera, 4.1, 2),
    ):
        cache.layers(view, blur, [2])
        assert len(projected_layers) == count
    cache.layers(replace(camera, fx=camera.fx + 1), 1.0, [2])
    assert len(projected_layers) == 3


def test_a_layer_at_two_rates_is_projected_once(cache_and_projected):
    cache, projected_layers = cache_and_projected
    first, second, third = cache.layers(frame_camera(), 1.0, [3, 3, 2])
    assert projected_layers == [3, 2]
    assert first == second
    assert first != third


def test_nothing_in_sight_is_empty(arrays):
    g = gaussians(n=20, degree=0)
    g.means[2] -= 100
    cache = ForestFootprints(arrays, forest_of([static_layer(g)], 120.0, "", ""))
    assert [len(part) for part in cache.layers(frame_camera(), 1.0, [1])] == [0]
