"""Light from lights at single points: closed forms, also by way of mirrors, metal and glass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.light_selection import light_numbers
from pathtrace.fill.gather import SAMPLES, Followed, followed, lit, stratified, surfaces_at

pytestmark = pytest.mark.usefixtures("backend")
COUNT = 40000
UP = (0.0, 1.0, 0.0)


def scene(**parts: dict[str, Any]) -> Any:
    return mi.load_dict({"type": "scene", **parts})


def points(position: Any, normal: Any = UP, count: int = COUNT) -> Any:
    """The same point many times, or (N, 3) points."""
    place, side = (np.broadcast_to(np.float32(given), (count, 3)) for given in (position, normal))
    return surfaces_at((mi.Point3f(place.T), mi.Normal3f(side.T)), dr.arange(mi.UInt32, count))


def random(seed: int, lanes: int = COUNT) -> Any:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, lanes)
    return sampler


def lit_at(lights: Any, at: Any, seed: int = 0, active: Any = True) -> tuple[np.ndarray, ...]:
    """(N, 3) irradiance, (N, 3) by shadow rays, (N,) index of the light."""
    sampler = random(seed, dr.width(at.p))
    asked = mi.Bool(active) & dr.full(mi.Bool, True, sampler.wavefront_size())
    irradiance, sampled, registered = lit(lights, at, sampler.next_2d(), sampler.next_2d(), asked)
    dr.eval(irradiance, sampled, registered)
    return irradiance.numpy().T, sampled.numpy().T, light_numbers(lights)[registered.numpy()]


def mean(values: np.ndarray) -> tuple[float, float]:
    """Mean, and four standard errors of it."""
    lanes = values if values.ndim == 1 else values.mean(axis=1)
    return float(lanes.mean()), 4 * float(lanes.std() / np.sqrt(len(lanes))) + 1e-6


def close(values: np.ndarray, expected: float, at_most: float) -> bool:
    """Whether a mean is the expected one up to its noise, which must not exceed a share of it."""
    found, error = mean(values)
    assert error < at_most * expected
    return abs(found - expected) < error


def sky(radiance: float = 1.0) -> dict[str, Any]:
    return {"type": "constant", "radiance": {"type": "rgb", "value": radiance}}


def point_light(position: list[float], intensity: float) -> dict[str, Any]:
    return {"type": "point", "position": position, "intensity": {"type": "rgb", "value": intensity}}


def square(
    height: float, half: float, radiance: float | None = None, bsdf: dict[str, Any] | None = None
) -> dict[str, Any]:
    """A horizontal square above or below the origin that faces it: a lamp, a surface, or both."""
    turn = 90 if height > 0 else -90
    place = mi.ScalarTransform4f().translate([0, height, 0]).rotate([1, 0, 0], turn).scale(half)
    shape: dict[str, Any] = {"type": "rectangle", "to_world": place}
    if radiance is not None:
        shape["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return shape if bsdf is None else {**shape, "bsdf": bsdf}


MIRROR = {"type": "conductor", "material": "none", "specular_reflectance": 0.5}
DIFFUSE = {"type": "twosided", "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.4}}}


def lambert(corners: np.ndarray, normal: np.ndarray) -> float:
    """Irradiance of a polygon of radiance 1 at the origin, all of it above the horizon (Lambert 1760)."""
    one = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    other = np.roll(one, -1, axis=0)
    across = np.cross(one, other)
    angle = np.arccos((one * other).sum(axis=1))
    edges = across / np.linalg.norm(across, axis=1, keepdims=True) * angle[:, None]
    return float(abs(edges.sum(axis=0) @ normal) / 2)


def test_each_group_of_lanes_has_one_point_in_each_quarter_of_the_square():
    lanes = 20000 * SAMPLES
    found = stratified(random(1, lanes), dr.arange(mi.UInt32, lanes)).numpy().T
    quarter, inside = np.divmod(2 * found, 1)
    name = quarter[:, 0] + 2 * quarter[:, 1]
    assert (np.sort(name.reshape(-1, SAMPLES), axis=1) == np.arange(SAMPLES)).all()
    # Inside of each, points are uniform: mean and variance of both axes, and no correlation.
    for number in range(SAMPLES):
        chosen = inside[name == number]
        np.testing.assert_allclose(chosen.mean(axis=0), 0.5, atol=4 * np.sqrt(1 / 12 / len(chosen)))
        np.testing.assert_allclose(np.cov(chosen.T), np.eye(2) / 12, atol=0.004)


@pytest.mark.parametrize("normal", [UP, (0.6, 0, -0.8), (0, -1, 0)])
def test_under_an_even_sky_irradiance_is_pi_times_its_radiance(normal):
    total, sampled, _ = lit_at(scene(sky=sky(2.0)), points([1, 2, 3], normal))
    assert close(total, 2 * np.pi, 0.02)
    # The balance heuristic leaves half of the light to a density of 1 / 4 pi, but for a logarithm.
    assert close(sampled, 2 * 2 * np.pi * (1 / 4 - np.log(5) / 16), 0.05)


def test_a_point_light_gives_intensity_times_cosine_over_squared_distance():
    rng = np.random.default_rng(0)
    position, lamp = rng.uniform(-1, 1, (500, 3)), np.array([0.3, 1.5, -0.2])
    normal = rng.normal(size=(500, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    way = lamp - position
    squared = (way**2).sum(axis=1)
    expected = 3 * np.maximum((way * normal).sum(axis=1), 0) / squared**1.5
    total, sampled, light = lit_at(scene(lamp=point_light(lamp.tolist(), 3.0)), points(position, normal, 500))
    assert 100 < (expected == 0).sum() < 400
    np.testing.assert_allclose(total, np.stack([expected] * 3, axis=1), rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(sampled, total)
    assert (light == 0).all()


def test_of_two_lights_each_is_chosen_half_of_the_time_and_counts_twice():
    lights = scene(dim=point_light([0, 1, 0], 1.0), strong=point_light([0, 2, 0], 12.0))
    total, _, light = lit_at(lights, points([0, 0, 0]))
    # Intensity over squared distance.
    alone = {1.0: 1.0, 12.0: 3.0}
    for number, one in enumerate(lights.emitters()):
        intensity = float(mi.traverse(one)["intensity.value"].x[0])
        np.testing.assert_allclose(total[light == number], 2 * alone.pop(intensity), rtol=1e-4)
        assert close((light == number).astype(float), 0.5, 0.05)
    assert not alone


@pytest.mark.parametrize("normal", [(0, 1, 0), (0.6, 0.8, 0), (-0.48, 0.6, 0.64)])
def test_a_small_lamp_gives_the_irradiance_of_a_polygon(normal):
    half, height = 0.3, 1.2
    corners = np.array([[x * half, height, z * half] for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    assert (corners @ normal > 0).all()
    expected = 5 * lambert(corners, np.array(normal))
    total, sampled, _ = lit_at(scene(lamp=square(height, half, 5.0)), points([0, 0, 0], normal))
    assert close(total, expected, 0.02)
    # Nearly all of the light of a small lamp is found by shadow rays.
    assert 0.9 * expected < mean(sampled)[0] < 0.99 * expected


def test_a_lamp_that_touches_a_point_has_no_fireflies():
    """Shadow rays alone would have any brightness."""
    total, sampled, _ = lit_at(scene(lamp=square(1e-3, 1.0, 2.0)), points([0, 0, 0]))
    assert close(total, 2 * np.pi, 0.01)
    # Either of the two samples is at most as bright as rays alone would be.
    assert total.max() < 2 * 2 * np.pi * 1.001
    assert mean(sampled)[0] < 0.05 * np.pi


def test_one_square_is_for_the_lights_and_the_other_for_directions():
    world, at, sampler = scene(sky=sky()), points([0, 0, 0]), random(2)
    fixed, spread, every = mi.Point2f(0.6, 0.2), sampler.next_2d(), dr.full(mi.Bool, True, COUNT)
    for squares, constant in (((fixed, spread), True), ((spread, fixed), False)):
        total, sampled, _ = lit(world, at, *squares, every)
        dr.eval(total, sampled)
        by_lights, by_rays = sampled.x.numpy(), (total - sampled).x.numpy()
        assert (np.ptp(by_lights) < 1e-5) == constant
        assert (np.ptp(by_rays) > 0.1) == constant


def test_what_stands_in_the_way_casts_a_shadow():
    shade = square(1.0, 0.5, bsdf=DIFFUSE)
    for lamp, shaded in (
        (point_light([0, 2, 0], 3.0), True),
        (square(2.0, 0.4, 3.0), True),
        (point_light([0, 0.5, 0], 3.0), False),
        (square(0.5, 0.4, 3.0), False),
    ):
        total, sampled, _ = lit_at(scene(shade=shade, lamp=lamp), points([0, 0, 0], count=1000))
        assert (total == 0).all() == (sampled == 0).all() == shaded


def test_a_light_behind_a_surface_gives_nothing():
    total, sampled, _ = lit_at(scene(lamp=square(-1.0, 5.0, 3.0)), points([0, 0, 0]))
    assert (total == 0).all()
    assert (sampled == 0).all()


def test_points_that_are_not_asked_for_get_nothing():
    asked = np.arange(1000) % 3 == 0
    for lights in (scene(sky=sky()), scene(lamp=point_light([0, 1, 0], 1.0))):
        total, sampled, _ = lit_at(lights, points([0, 0, 0], count=1000), active=asked)
        assert (total[~asked] == 0).all()
        assert (sampled[~asked] == 0).all()
        assert (total[asked] > 0).any()


def test_light_that_is_not_finite_is_black():
    total, sampled, _ = lit_at(endless(square(1.0, 1.0, 1.0)), points([0, 0, 0]))
    assert (total == 0).all()
    assert (sampled == 0).all()


def endless(lamp: dict[str, Any], **parts: dict[str, Any]) -> Any:
    """A scene with a lamp of infinite radiance."""
    lights = scene(lamp=lamp, **parts)
    parameters = mi.traverse(lights.emitters()[0])
    parameters["radiance.value"] = mi.Color3f(np.inf)
    parameters.update()
    return lights


def sent(
    world: Any, where: Any = None, seed: int = 0, position: Any = (0, 0, 0), active: bool = True
) -> Followed:
    """What rays found that start upwards from a point, in random directions if there are none given."""
    sampler, at = random(seed), points(position)
    square = sampler.next_2d() if where is None else where
    found = followed(world, sampler, at, square, dr.full(mi.Bool, active, COUNT))
    dr.eval(found.radiance, found.hit, found.side, found.valid, found.shiny, found.bounces, found.reflectance)
    return found


def narrow() -> Any:
    """Squares of directions less than 24 degrees from the normal."""
    return mi.Point2f(np.random.default_rng(3).uniform(0.3, 0.7, (2, COUNT)).astype(np.float32))


def check(found: Followed, radiance: float, bounces: int, reflectance: float | None) -> None:
    """Whether all rays found the same; the reflectance is None where they end nowhere."""
    np.testing.assert_allclose(found.radiance.numpy(), radiance, rtol=1e-5)
    assert (found.bounces.numpy() == bounces).all()
    assert (found.valid.numpy() == (reflectance is not None)).all()
    np.testing.assert_allclose(found.reflectance.numpy(), reflectance or 0.0, rtol=1e-5)


def test_directions_are_weighted_by_the_cosine_and_stand_in_the_square():
    world = scene(
        shell={"type": "sphere", "radius": 1.0, "flip_normals": True, "bsdf": DIFFUSE["b"]}, sky=sky()
    )
    where = random(7).next_2d()
    found, again = (sent(world, where, seed) for seed in (1, 2))
    direction = found.hit.p.numpy()
    np.testing.assert_array_equal(direction, again.hit.p.numpy())
    np.testing.assert_allclose(np.linalg.norm(direction, axis=0), 1, rtol=1e-4)
    assert direction[1].min() > 0
    assert close(direction[1], 2 / 3, 0.01)
    assert close(direction[1] ** 2, 1 / 2, 0.02)
    assert max(abs(direction[0].mean()), abs(direction[2].mean())) < 4 * 0.5 / np.sqrt(COUNT)
    ahead = sent(world, mi.Point2f(0.5, 0.5))
    np.testing.assert_allclose(ahead.hit.p.numpy()[:, 0], UP, atol=1e-5)


@pytest.mark.parametrize("turned", [False, True])
def test_a_diffuse_wall_ends_the_way_and_reflects_towards_the_point(turned):
    wall = square(1.0, 100.0, bsdf=DIFFUSE)
    if turned:
        wall["flip_normals"] = True
    found = sent(scene(wall=wall, sky=sky()), narrow())
    check(found, radiance=0, bounces=0, reflectance=0.4)
    assert not found.shiny.numpy().any()
    np.testing.assert_allclose(found.hit.p.y.numpy(), 1, rtol=1e-5)
    np.testing.assert_allclose(found.side.numpy().T, [[0, -1, 0]] * COUNT, atol=1e-5)


def test_a_black_wall_ends_the_way_and_reflects_nothing():
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    found = sent(scene(wall=square(1.0, 100.0, bsdf=black), sky=sky()), narrow())
    check(found, radiance=0, bounces=0, reflectance=None)


def test_lights_are_found_by_way_of_mirrors_only():
    """What is seen directly was sampled as a light."""
    lamp, ceiling = square(-1.0, 50.0, 2.0, DIFFUSE["b"]), square(1.0, 50.0, bsdf=MIRROR)
    found = sent(scene(lamp=lamp, ceiling=ceiling), narrow())
    check(found, radiance=0.5 * 2, bounces=1, reflectance=0.5 * 0.4)
    assert found.shiny.numpy().all()
    np.testing.assert_allclose(found.hit.p.y.numpy(), -1, rtol=1e-5)
    np.testing.assert_allclose(found.side.numpy().T, [[0, 1, 0]] * COUNT, atol=1e-5)
    overhead = square(1.0, 50.0, 2.0, DIFFUSE["b"])
    check(sent(scene(lamp=overhead), narrow()), radiance=0, bounces=0, reflectance=0.4)
    check(sent(scene(sky=sky())), radiance=0, bounces=0, reflectance=None)
    check(sent(scene(sky=sky(), ceiling=ceiling), narrow()), radiance=0.5, bounces=1, reflectance=None)
    check(sent(endless(lamp, ceiling=ceiling), narrow()), radiance=0, bounces=1, reflectance=0.5 * 0.4)


def test_a_window_reflects_what_it_does_not_let_through():
    found = sent(scene(sky=sky(3.0), pane=square(1.0, 1e4, bsdf={"type": "thindielectric"})), narrow())
    check(found, radiance=3, bounces=1, reflectance=None)


@pytest.mark.parametrize(("panes", "seen"), [(5, True), (6, True), (7, False)])
def test_at_most_six_surfaces_are_passed(panes, seen):
    stack = {f"pane_{n}": square(0.1 + 0.1 * n, 50.0, bsdf={"type": "null"}) for n in range(panes)}
    found = sent(scene(lamp=square(1.0, 50.0, 2.0, DIFFUSE["b"]), **stack), narrow())
    if seen:
        check(found, radiance=2, bounces=panes, reflectance=0.4)
    else:
        check(found, radiance=0, bounces=6, reflectance=None)


def test_plastic_ends_some_ways_and_shows_lights_on_the_others():
    found = sent(scene(ceiling=square(1.0, 1e4, bsdf={"type": "plastic"}), sky=sky()), narrow())
    ends, bounces, radiance = found.valid.numpy(), found.bounces.numpy(), found.radiance.numpy()
    assert found.shiny.numpy().all()
    assert 0.02 < ends.mean() < 0.98
    np.testing.assert_array_equal(bounces, np.where(ends, 0, 1))
    assert (radiance[:, ends] == 0).all()
    assert (radiance[:, ~ends] > 0).all()
    assert (found.reflectance.numpy()[:, ends] > 0).all()
    assert (found.reflectance.numpy()[:, ~ends] == 0).all()


def test_rays_that_are_not_asked_for_find_nothing():
    world = scene(sky=sky(), ceiling=square(1.0, 50.0, bsdf=MIRROR))
    found = sent(world, narrow(), active=False)
    check(found, radiance=0, bounces=0, reflectance=None)
    assert not found.shiny.numpy().any()


METAL = {"type": "roughconductor", "material": "none", "alpha": 0.4}


def hit_head_on(bsdf: dict[str, Any], width: int) -> tuple[Any, Any]:
    """A surface and where it is hit along its normal."""
    hit = dr.zeros(mi.SurfaceInteraction3f, width)
    hit.wi = mi.Vector3f(0, 0, 1)
    return mi.load_dict(bsdf), hit


def test_rough_metal_shows_an_even_sky_by_its_albedo():
    """The albedo by Mitsuba's own samples of the metal."""
    bsdf, hit = hit_head_on(METAL, COUNT)
    sampler = random(8)
    _, weight = bsdf.sample(mi.BSDFContext(), hit, sampler.next_1d(), sampler.next_2d())
    found = sent(scene(sky=sky(2.0), ceiling=square(1.0, 100, bsdf=METAL)), mi.Point2f(0.5, 0.5))
    assert close(found.radiance.numpy().T, 2 * float(weight.numpy().mean()), 0.02)
    assert found.shiny.numpy().all()
    assert (found.reflectance.numpy() == 0).all()


def test_rough_metal_shows_a_small_lamp_by_its_reflectance():
    """By quadrature over the lamp, 2 below the metal, seen from a point in between."""
    half, side = 0.4, 100
    x, z = np.meshgrid(*[((np.arange(side) + 0.5) / side * 2 - 1) * half] * 2)
    squared = x.ravel() ** 2 + z.ravel() ** 2 + 4
    cosine = 2 / np.sqrt(squared)
    bsdf, hit = hit_head_on(METAL, side**2)
    direction = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine]).astype(np.float32)
    # With the cosine at the metal.
    reflected = bsdf.eval(mi.BSDFContext(), hit, mi.Vector3f(direction)).numpy()[0]
    expected = 5 * (reflected * cosine / squared).sum() * (2 * half / side) ** 2
    lamp = square(-1.0, half, 5.0)
    found = sent(scene(lamp=lamp, ceiling=square(1.0, 100, bsdf=METAL)), mi.Point2f(0.5, 0.5))
    assert close(found.radiance.numpy().T, expected, 0.03)
    # Both ways to find it are weighed against each other: no sample is much brighter than their mean.
    assert found.radiance.numpy().max() < 5 * expected
