"""Forests in other light than that they were trained in."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from compose.camera.coordinate_systems import WORLD, Place
from hybrid.render.forest_light import ForestLight
from hybrid.render.frame_renderer import LiveRenderer, Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.cache.cells import Points
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace import Integrator
from splat.model.forest import Forest, forest_of
from splat.model.gaussians import SH_DC, Gaussians, perceptual_from_radiance, radiance_from_perceptual
from splat.model.trees import static_layer
from tests import small
from tests.hybrid.forests import white_dot

pytestmark = pytest.mark.usefixtures("backend", "own_home")
FACTORS = np.float32([0.4, 1.0, 2.0])


@pytest.fixture(scope="module")
def cache(backend) -> IrradianceCache:
    scene = load_scene(small.corner())
    return fill_cache(scene, [scene.camera], points=1 << 13)


def brighter(cache: IrradianceCache, factors) -> IrradianceCache:
    """The cache in light that is that many times as bright, in each channel or each cell."""
    return replace(cache, irradiance=cache.irradiance * np.float32(factors))


def on_surfaces(cache: IrradianceCache, place: Place = WORLD) -> Forest:
    """Grey dots on 200 points that a cache knows, and that are not dark."""
    points, light = cache.transfer.points, cache.irradiance[-1].min(axis=1)
    cells = cache.cells.smallest(points)
    known = points.take((cells >= 0) & (light[cells] > 0.5 * light.mean()))
    means = place.from_world(known.position[:200]).T
    count = means.shape[1]
    dots = Gaussians(
        torch.from_numpy(means).float(),
        torch.full((3, count), -4.0),
        torch.tensor([[1.0], [0], [0], [0]]).repeat(1, count),
        torch.full((count,), 8.0),
        torch.full((1, 3, count), float((perceptual_from_radiance(torch.tensor(0.3)) - 0.5) / SH_DC)),
    )
    return forest_of([static_layer(dots)], 50.0, "", "", place)


def radiance(gaussians: Gaussians) -> np.ndarray:
    """(3, N) mean over directions."""
    return radiance_from_perceptual(0.5 + SH_DC * gaussians.sh[0]).numpy()


@pytest.mark.parametrize("place", [WORLD, Place((100.0, -20.0, 3.0), 0.01)])
def test_radiance_follows_irradiance_in_each_channel(cache, place):
    light = ForestLight(on_surfaces(cache, place), cache)
    shown = radiance(light.under(brighter(cache, FACTORS)).finest)
    np.testing.assert_allclose(shown, 0.3 * np.broadcast_to(FACTORS[:, None], shown.shape), rtol=0.01)
    np.testing.assert_allclose(radiance(light.under(cache).finest), 0.3, rtol=1e-5)


def test_each_node_has_the_light_of_its_surroundings(cache):
    """A half of the scene, told by x, becomes dark; the largest cells are 1.3 wide."""
    points = cache.transfer.points
    cells = cache.cells.smallest(points)
    left = np.zeros(len(cache.cells))
    np.add.at(left, cells[cells >= 0], np.where(points.position[cells >= 0, 0] < 0, 1, -1))
    forest = on_surfaces(cache)
    x = forest.finest.means[0].numpy()
    shown = radiance(ForestLight(forest, cache).under(brighter(cache, left[:, None] < 0)).finest)
    left, right = shown[:, x < -0.5], shown[:, x > 0.5]
    assert min(left.size, right.size) > 60
    assert np.quantile(left, 0.9) < 0.03
    assert np.quantile(right, 0.1) > 0.25


def cache_of(points: Points, light: list[float]) -> SimpleNamespace:
    """What is read of a cache, each of whose points is a cell."""
    cells = SimpleNamespace(smallest=lambda asked: np.arange(len(asked)), grid=SimpleNamespace(scale=1.0))
    irradiance = np.float32(light)[None, :, None].repeat(3, 2)
    return SimpleNamespace(transfer=SimpleNamespace(points=points), cells=cells, irradiance=irradiance)


def test_thin_walls_have_the_light_of_both_sides_and_not_of_what_they_stand_on():
    """Ten times the light on a floor changes a flat node that stands on it by less than a tenth."""
    positions = np.float32([[0, 0.01, 0], [0, 0, 0.01], [0.01, 0, 0], [0, 0, -0.01]])
    points = Points(positions, np.float32([[0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, -1]]))
    dot = white_dot((0, 0, 0))
    dot.finest.log_scales[:] = torch.tensor([[-1.0], [-1.0], [-5.0]])
    light = ForestLight(dot, cache_of(points, [1, 1, 1, 1]))
    assert np.all(radiance(light.under(cache_of(points, [10, 1, 10, 1])).finest) < 1.1 * radiance(dot.finest))
    shown = radiance(light.under(cache_of(points, [1, 3, 1, 1])).finest)
    np.testing.assert_allclose(shown, 2 * radiance(dot.finest), rtol=0.02)


def test_the_light_of_nodes_has_bounds(cache):
    """What is near no surface, such as a sky, keeps its light; so does all without a cache."""
    far = replace(white_dot((0, 0, 500.0)), scene_name="far")
    lit = ForestLight(far, cache).under(brighter(cache, 3))
    np.testing.assert_allclose(radiance(lit.finest), radiance(far.finest), rtol=1e-5)
    forest, nothing = on_surfaces(cache), IrradianceCache.empty(1)
    np.testing.assert_allclose(radiance(ForestLight(forest, nothing).under(nothing).finest), 0.3, rtol=1e-5)
    bright = radiance(ForestLight(forest, brighter(cache, 1e-12)).under(brighter(cache, 1e12)).finest)
    np.testing.assert_allclose(bright, 8 * 0.3, rtol=1e-3)
    dark = radiance(ForestLight(forest, cache).under(brighter(cache, 0)).finest)
    assert 0 <= dark.min() <= dark.max() < 0.003


def test_fitted_inner_nodes_have_the_same_light(cache):
    forest = on_surfaces(cache)
    hierarchy = forest.own_hierarchy
    inner = forest.hierarchy_nodes.gaussians.part(len(forest.finest), len(forest.finest) + len(hierarchy))
    fitted = replace(forest, hierarchy=replace(hierarchy, inner=inner))
    lit = ForestLight(fitted, cache).under(brighter(cache, 2))
    np.testing.assert_allclose(radiance(lit.hierarchy.inner), 2 * radiance(inner), rtol=0.01)
    assert ForestLight(forest, cache).under(cache).hierarchy is forest.hierarchy


def settings(scene: Scene, integrator: Integrator = Integrator.CACHED) -> FrameSettings:
    camera = scene.camera.resized(48, 48)
    return FrameSettings(fov_a=5, fov_b=4, spp=1, fovea="raw", camera=camera, integrator=integrator)


@pytest.mark.parametrize("kind", [Renderer, LiveRenderer])
def test_splats_follow_a_lamp_and_its_frames_do_so_at_once(lamp, forest, kind):
    scene, set_lamp = lamp
    renderer, chosen = kind(scene, forest), settings(scene)
    before = renderer.frame(chosen).splats.numpy()
    set_lamp(6.0)
    renderer.lights_changed()
    first = renderer.frame(chosen, 1).splats.numpy()
    assert first.mean() == pytest.approx(before.mean() / 2, rel=0.1)
    seed = 2
    while renderer.light_renewed < 1:
        renderer.frame(chosen, seed)
        seed += 1
    after = renderer.frame(chosen, seed).splats.numpy()
    assert after.mean() == pytest.approx(before.mean() / 2, rel=0.03)
    # Another forest of the scene shows the light as it was loaded, too.
    renderer.show_forest(forest)
    np.testing.assert_allclose(renderer.frame(chosen, seed).splats.numpy(), after, atol=1e-6)


def test_a_lamp_that_was_switched_off_and_on_again_leaves_no_trace(lamp, forest):
    scene, set_lamp = lamp
    renderer, chosen = LiveRenderer(scene, forest), settings(scene)
    before = renderer.frame(chosen).splats.numpy()
    for radiance_of_lamp in (0.0, 12.0):
        set_lamp(radiance_of_lamp)
        renderer.lights_changed()
        for seed in range(40):
            shown = renderer.frame(chosen, seed).splats.numpy()
        assert renderer.light_renewed == 1
        if not radiance_of_lamp:
            assert shown.mean() < 0.05 * before.mean()
    assert shown.mean() == pytest.approx(before.mean(), rel=0.03)


@pytest.mark.parametrize(("reflectance", "least"), [(0.1, 0.7), (0.0, 0.999)])
def test_splats_have_the_light_that_changed_surfaces_reflect(lamp, forest, reflectance, least):
    """Their own reflectance is still to be learnt; black surfaces have no light that is known."""
    scene, _ = lamp
    renderer, chosen = Renderer(scene, forest), settings(scene)
    before = renderer.frame(chosen).splats.numpy()
    small.set_all(scene, "reflectance.value", reflectance)
    renderer.surfaces_changed()
    after = renderer.frame(chosen).splats.numpy()
    assert least * before.mean() < after.mean() < 1.001 * before.mean()


def test_splats_stay_as_they_were_trained_where_nothing_is_known_of_the_light(lamp, forest):
    scene, set_lamp = lamp
    renderer, chosen = Renderer(scene, forest), settings(scene, Integrator.PATH)
    before = renderer.frame(chosen).splats.numpy()
    set_lamp(6.0)
    renderer.lights_changed()
    np.testing.assert_array_equal(renderer.frame(chosen).splats.numpy(), before)
