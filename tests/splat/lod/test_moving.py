"""Forests in which something moves, at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.lod.footprints import LayerChanges
from splat.lod.forest_renderer import ForestRenderer
from splat.lod.layer_images import LayerImage
from splat.model.dynamic_light import LightCourse, factors_at, in_light, seen_from_behind
from splat.model.forest import Forest
from splat.model.motion import posed
from tests.splat.lod.views import CORNERS, drawn, everything, frame_camera, no_cutoff, small_forest
from tests.splat.model.test_motion import COUNT, random_motion


def moving_forest() -> Forest:
    """Every third tree moves, as one of the instances."""
    forest = small_forest()
    semantic: list[torch.Tensor] = []
    for layer in forest.layers:
        roots = torch.arange(len(layer)) % (3 * COUNT)
        own = (
            torch.where(roots < COUNT, roots, -1).int() if not semantic else semantic[-1][layer.parent.long()]
        )
        semantic.append(own)
    labels = torch.cat(semantic)
    nodes = replace(forest.nodes, semantic=labels, dynamic=labels >= 0)
    motion = random_motion()[0]
    return replace(forest, nodes=nodes, motion=replace(motion, shifts=0.3 * motion.shifts))


def as_posed(forest: Forest, time: float) -> Forest:
    """A forest that stands still as the other one is at a time."""
    assert forest.motion is not None
    gaussians = posed(forest.nodes.gaussians, forest.nodes.semantic, forest.motion.at(time))
    return replace(forest, nodes=replace(forest.nodes, gaussians=gaussians), motion=None)


@pytest.mark.parametrize("layer", [1, 2, 3])
def test_a_forest_at_a_time_is_that_of_its_posed_nodes(arrays, layer):
    forest, camera = moving_forest(), frame_camera()
    renderer = ForestRenderer(arrays, forest)
    rest = ForestRenderer(arrays, replace(forest, motion=None)).render_layer(camera, layer).numpy()
    for time in (0.3, 0.7, 0.3, 1.0):
        renderer.set_time(time)
        found = renderer.render_layer(camera, layer).numpy()
        expected = ForestRenderer(arrays, as_posed(forest, time)).render_layer(camera, layer).numpy()
        np.testing.assert_allclose(found, expected, atol=1e-5)
        assert np.abs(found - rest).max() > 0.05


def test_layers_that_are_composited_move_as_well(arrays):
    forest, camera = moving_forest(), frame_camera()
    weight = np.full(CORNERS, 0.5, dtype=np.float32)
    images = [LayerImage(2, 1, weight), LayerImage(3, 0, weight)]
    renderer = ForestRenderer(arrays, forest)
    drawn(renderer, camera, images, no_cutoff(), everything())
    renderer.set_time(0.6)
    found = drawn(renderer, camera, images, no_cutoff(), everything()).numpy()
    still = ForestRenderer(arrays, as_posed(forest, 0.6))
    np.testing.assert_allclose(
        found, drawn(still, camera, images, no_cutoff(), everything()).numpy(), atol=1e-5
    )


def test_only_layers_that_are_drawn_are_deformed(arrays, monkeypatch):
    """Once per time, whatever the camera; and a layer that is drawn later is where it belongs."""
    forest, camera = moving_forest(), frame_camera()
    renderer, posed_nodes = ForestRenderer(arrays, forest), []
    original = LayerChanges.moved

    def counted(self, time):
        found = original(self, time)
        posed_nodes.append(0 if found is None else len(found[0]))
        return found

    monkeypatch.setattr(LayerChanges, "moved", counted)
    renderer.set_time(0.7)
    assert posed_nodes == []
    renderer.render_layer(camera, 3)
    own = [int((layer.semantic >= 0).sum()) for layer in forest.layers]
    assert posed_nodes == [own[2]]
    renderer.render_layer(camera.moved_right(0.1), 3)
    assert posed_nodes == [own[2], 0]
    expected = ForestRenderer(arrays, as_posed(forest, 0.7)).render_layer(camera, 1).numpy()
    np.testing.assert_allclose(renderer.render_layer(camera, 1).numpy(), expected, atol=1e-5)
    assert sum(posed_nodes) == own[2] + own[0]


@pytest.mark.parametrize("some", [False, True])
def test_nodes_have_the_light_of_the_time(arrays, some):
    forest, camera = moving_forest(), frame_camera()
    if some:
        own = forest.nodes.gaussians.turning(torch.arange(len(forest.nodes)) % 3 == 0)
        forest = replace(forest, nodes=replace(forest.nodes, gaussians=own))
    nodes = torch.arange(0, len(forest.nodes), 2)
    factors = (torch.rand(3, 3, len(nodes), generator=torch.Generator().manual_seed(4)) * 2).half()
    lit = replace(forest, light=LightCourse(nodes, factors))
    renderer = ForestRenderer(arrays, lit)
    for time in (0.0, 0.7, 0.2):
        renderer.set_time(time)
        now = in_light(forest.nodes.gaussians, nodes, factors_at(lit.light.factors, time))
        shown = replace(forest, nodes=replace(forest.nodes, gaussians=now))
        expected = ForestRenderer(arrays, as_posed(shown, time)).render_layer(camera, 3).numpy()
        np.testing.assert_allclose(renderer.render_layer(camera, 3).numpy(), expected, atol=1e-4)


def test_sided_nodes_have_the_light_of_the_side_that_is_seen(arrays):
    """From either end of the normals, without and with a step of time between."""
    forest = moving_forest()
    nodes = torch.arange(len(forest.nodes))
    generator = torch.Generator().manual_seed(6)
    front, back = ((torch.rand(3, 3, len(nodes), generator=generator) * 2).half() for _ in range(2))
    camera = frame_camera()
    eye = torch.from_numpy(camera.position.copy()).float()
    # At time 0, of those that stand still, every other one is seen from behind.
    towards = (eye[:, None] - forest.nodes.gaussians.means) * torch.tensor([1.0, -1.0]).repeat(len(nodes))[
        : len(nodes)
    ]
    light = LightCourse(nodes, front, nodes.clone(), back, towards / towards.norm(dim=0))
    renderer = ForestRenderer(arrays, replace(forest, light=light))
    for time in (0.0, 0.7):
        renderer.set_time(time)
        own = as_posed(forest, time).nodes.gaussians
        rest = forest.nodes.gaussians
        behind = seen_from_behind(light.normals, rest.rotations, own.rotations, own.means, eye)
        now = in_light(
            rest, nodes, torch.where(behind, factors_at(light.behind, time), factors_at(light.factors, time))
        )
        shown = replace(forest, nodes=replace(forest.nodes, gaussians=now))
        expected = ForestRenderer(arrays, as_posed(shown, time)).render_layer(camera, 3).numpy()
        found = renderer.render_layer(camera, 3).numpy()
        np.testing.assert_allclose(found, expected, atol=1e-4)
        from_in_front = replace(
            light, sided=light.sided[:0], behind=torch.zeros(3, 3, 0).half(), normals=torch.zeros(3, 0)
        )
        plain = ForestRenderer(arrays, replace(forest, light=from_in_front))
        plain.set_time(time)
        assert np.abs(plain.render_layer(camera, 3).numpy() - found).max() > 0.05


def test_light_of_nodes_that_there_are_not_is_refused():
    forest = moving_forest()
    count = len(forest.nodes)
    with pytest.raises(ValueError, match=f"light of nodes 0 to {count}; there are {count}"):
        replace(forest, light=LightCourse(torch.tensor([0, count]), torch.ones(2, 3, 2).half()))


def test_forests_without_motion_look_alike_at_all_times(arrays):
    forest, camera = small_forest(), frame_camera()
    renderer = ForestRenderer(arrays, forest)
    before = renderer.render_layer(camera, 3).numpy()
    renderer.set_time(0.5)
    np.testing.assert_array_equal(renderer.render_layer(camera, 3).numpy(), before)


def test_nodes_of_unknown_instances_are_refused():
    forest = moving_forest()
    nodes = replace(forest.nodes, semantic=forest.nodes.semantic + 1)
    with pytest.raises(ValueError, match=f"nodes of instance {COUNT}; there are motions of {COUNT}"):
        replace(forest, nodes=nodes)
