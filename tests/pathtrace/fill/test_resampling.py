"""Samples of lights, part by part: all points and rays in their turn, and closed forms of what they get."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.cells import Points
from pathtrace.cache.transport import Rays, Transfer
from pathtrace.fill.gather import SAMPLES
from pathtrace.fill.relight import Part, Resampling
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
UP = np.float32([0, 1, 0])
# Position and intensity of point lights.
LIGHTS = {"near": ([0.5, 1.0, 0.0], 1.0), "far": ([-1.0, 3.0, 0.5], 20.0)}


def transfer_of(points: Points, rays: Rays | None = None) -> Transfer:
    """Points and rays, without the transport of light, which is not asked for."""
    return replace(Transfer.none(), points=points, rays=rays or Transfer.none().rays)


def floor(count: int, seed: int = 0) -> Points:
    """Points on a floor at y = 0."""
    position = small.rng(seed).uniform(-2, 2, (count, 3)).astype(np.float32)
    position[:, 1] = 0
    return Points(position, np.tile(UP, (count, 1)))


def any_rays(count: int, points: int) -> Rays:
    random = small.rng(9)
    start, square = random.integers(0, points, count).astype(np.int32), random.random((count, 2), np.float32)
    return Rays(start, square, random.random(count, np.float32))


def horizontal(x: float, y: float, half: float, **parts: Any) -> dict[str, Any]:
    """A square that faces y = 0."""
    place = mi.ScalarTransform4f().translate([x, y, 0]).rotate([1, 0, 0], 90 if y > 0 else -90).scale(half)
    return {"type": "rectangle", "to_world": place, **parts}


def lamps(*names: str) -> Any:
    """A scene of point lights, and a wall below the floor."""
    parts: dict[str, Any] = {"wall": horizontal(0, -1, 10)}
    for name in names:
        position, intensity = LIGHTS[name]
        value = {"type": "rgb", "value": intensity}
        parts[name] = {"type": "point", "position": position, "intensity": value}
    return mi.load_dict({"type": "scene", **parts})


def given_by(name: str, points: Points) -> np.ndarray:
    """(N,) irradiance of a floor's points by a point light: intensity times cosine over squared distance."""
    position, intensity = LIGHTS[name]
    way = np.array(position) - points.position
    return intensity * way[:, 1] / (way**2).sum(axis=1) ** 1.5


def round_of(resampling: Resampling, parts: int) -> list[Part]:
    return [resampling.next_part() for _ in range(parts)]


@pytest.mark.parametrize(
    ("points", "rays", "parts"), [(23, 11, 5), (24, 12, 4), (3, 8, 5), (7, 1, 3), (10, 4, 1), (9, 0, 4)]
)
def test_in_each_round_every_point_and_ray_has_one_turn(points, rays, parts):
    resampling = Resampling(lamps("near"), transfer_of(floor(points), any_rays(rays, points)), parts, seed=0)
    for _ in range(2):
        found = round_of(resampling, parts)
        for name, count, values in (
            ("points", points, [part.direct() for part in found]),
            ("rays", rays, [part.reflected() for part in found]),
        ):
            turns = [np.arange(count)[getattr(part, name)] for part in found]
            np.testing.assert_array_equal(np.concatenate(turns), np.arange(count))
            assert [len(turn) for turn in turns] == [len(value) for value in values]
            assert {value.shape[1:] for value in values} == {(3,)}
            assert max(len(turn) for turn in turns) == -(-count // parts)
        # Each point has so many samples of lights, and is numbered within its part.
        for part in found:
            here = part.points.stop - part.points.start
            lights = part.lights()
            np.testing.assert_array_equal(lights.point, np.repeat(np.arange(here), SAMPLES))
            assert len(lights.light) == len(lights.irradiance) == here * SAMPLES


def test_each_point_gets_its_own_light():
    points = floor(23)
    expected = given_by("near", points)
    resampling = Resampling(lamps("near"), transfer_of(points), 5, seed=0)
    for number in range(12):
        part = resampling.next_part()
        assert part.points == slice(5 * (number % 5), min(5 * (number % 5) + 5, 23))
        direct = part.direct()
        assert direct.dtype == np.float32
        np.testing.assert_allclose(direct, np.stack([expected[part.points]] * 3, axis=1), rtol=1e-4)


def test_samples_belong_to_the_lights_that_they_name():
    """Of two lights, each is chosen by chance and counts twice."""
    points, scene = floor(2000), lamps("near", "far")
    order = [float(mi.traverse(light)["intensity.value"].x[0]) for light in scene.emitters()]
    names = [next(name for name in LIGHTS if LIGHTS[name][1] == intensity) for intensity in order]
    alone = np.stack([given_by(name, points) for name in names])
    resampling = Resampling(scene, transfer_of(points), 3, seed=0)
    chosen = []
    for part in round_of(resampling, 3):
        lights = part.lights()
        assert set(lights.light) == {0, 1}
        expected = 2 * alone[:, part.points][lights.light, lights.point]
        np.testing.assert_allclose(lights.irradiance, expected, rtol=1e-4)
        # The mean over a point's samples is its direct light.
        sums = np.bincount(lights.point, lights.irradiance)
        np.testing.assert_allclose(part.direct(), np.stack([sums / SAMPLES] * 3, axis=1), rtol=1e-4)
        chosen.append(lights.light)
    # Strata make it more even than chance.
    assert abs(np.concatenate(chosen).mean() - 0.5) < 4 * 0.5 / np.sqrt(2000 * SAMPLES)


def test_the_number_of_a_light_is_its_index_in_the_scene_among_shapes_and_lights_of_other_kinds():
    scene = mi.load_dict(
        {
            **small.corner(),
            "spot": {"type": "point", "position": [0, 0, 0], "intensity": {"type": "rgb", "value": 3.0}},
        }
    )
    position = np.tile(np.float32([0, 0, 1.99]), (500, 1))
    points = Points(position, np.tile(np.float32([0, 0, -1]), (500, 1)))
    lights = Resampling(scene, transfer_of(points), 1, seed=2).next_part().lights()
    spot = ["Point" in light.class_name() for light in scene.emitters()].index(True)
    assert set(lights.light) == {0, 1}
    # Two lights, of which the spot gives its intensity over the squared distance.
    by_spot = lights.irradiance[lights.light == spot]
    np.testing.assert_allclose(by_spot, 2 * 3 / 1.99**2, rtol=1e-3)
    assert lights.irradiance[lights.light != spot].std() > 0.01


def test_in_a_closed_sphere_the_mean_is_pi_times_the_walls_emission():
    count = 4000
    direction = small.rng().normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = Points((2.999 * direction).astype(np.float32), (-direction).astype(np.float32))
    rays = any_rays(100, count)
    found = round_of(Resampling(mi.load_dict(small.furnace(0.5)), transfer_of(points, rays), 4, seed=1), 4)
    direct = np.concatenate([part.direct() for part in found]).mean(axis=1)
    error = direct.std() / np.sqrt(count)
    assert error < 0.01
    assert direct.mean() == pytest.approx(0.5 * np.pi, abs=4 * error)
    # A diffuse wall shows no light that was not sampled as one.
    assert all((part.reflected() == 0).all() for part in found)


def mirrors() -> Any:
    """A lamp below all points that is seen in three mirrors above them, of which one is small."""
    metal = lambda share: {"type": "conductor", "material": "none", "specular_reflectance": share}  # noqa: E731
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [2.0, 4.0, 8.0]}}
    return mi.load_dict(
        {
            "type": "scene",
            "lamp": horizontal(0, -1, 1000, emitter=emitter),
            "left": horizontal(-200, 1, 100, bsdf=metal(0.25)),
            "right": horizontal(200, 1, 100, bsdf=metal(0.75)),
            "small": horizontal(0, 1, 0.25, bsdf=metal(1.0)),
        }
    )


def test_each_ray_finds_the_light_in_its_own_mirror():
    x = np.array([-200, 0, 200, 0, 200, -200, -200])
    position = np.zeros((len(x), 3), dtype=np.float32)
    position[:, 0] = x
    random, count = small.rng(3), 90
    start = random.integers(0, len(x), count).astype(np.int32)
    # A direction along the normal, or 0.8 of the way to the horizon.
    ahead = random.random(count) < 0.5
    square = np.where(ahead[:, None], np.float32([0.5, 0.5]), np.float32([0.9, 0.5]))
    weight = random.random(count, np.float32)
    transfer = transfer_of(Points(position, np.tile(UP, (len(x), 1))), Rays(start, square, weight))
    reflectance = np.select([x[start] < 0, x[start] > 0], [0.25, 0.75], np.where(ahead, 1.0, 0.0))
    expected = (weight * reflectance)[:, None] * [2, 4, 8]
    assert len(np.unique(expected)) > 6
    resampling = Resampling(mirrors(), transfer, 4, seed=0)
    for number in range(9):
        part = resampling.next_part()
        assert part.rays == slice(23 * (number % 4), min(23 * (number % 4) + 23, 90))
        np.testing.assert_allclose(part.reflected(), expected[part.rays], rtol=1e-4)
        assert (part.direct() == 0).all()


def test_without_rays_nothing_is_reflected():
    resampling = Resampling(mirrors(), transfer_of(floor(10)), 3, seed=0)
    for part in round_of(resampling, 4):
        assert part.rays == slice(0, 0)
        assert part.reflected().shape == (0, 3)
        assert part.reflected().dtype == np.float32
        assert part.direct().shape == (part.points.stop - part.points.start, 3)


def test_each_part_shows_the_lights_as_they_were_when_it_was_sampled():
    points, scene = floor(12), lamps("near")
    expected = given_by("near", points)[:, None]
    resampling = Resampling(scene, transfer_of(points), 3, seed=0)
    parameters, parts = mi.traverse(scene), []
    for strength in (1.0, 0.5, 0.0, 3.0):
        parameters["near.intensity.value"] = mi.Color3f(strength)
        parameters.update()
        parts.append((strength, resampling.next_part()))
    # Read after all of them were sampled.
    for strength, part in parts:
        seen = np.broadcast_to(strength * expected[part.points], (4, 3))
        np.testing.assert_allclose(part.direct(), seen, rtol=1e-4)


def test_the_same_seed_gives_the_same_samples_and_each_round_has_new_ones():
    scene = mi.load_dict(small.corner())
    position = small.rng().uniform(-0.5, 0.5, (40, 3)).astype(np.float32)
    position[:, 2] = 1.99
    points = Points(position, np.tile(np.float32([0, 0, -1]), (40, 1)))
    transfer = transfer_of(points, any_rays(20, 40))
    one, same, other = (round_of(Resampling(scene, transfer, 2, seed), 4) for seed in (5, 5, 6))
    for mine, yours, theirs in zip(one, same, other, strict=True):
        assert (mine.direct() == yours.direct()).all()
        assert (mine.reflected() == yours.reflected()).all()
        assert (mine.lights().irradiance == yours.lights().irradiance).all()
        assert (mine.direct() != theirs.direct()).any()
    assert (one[0].direct() != one[2].direct()).any()


def test_parts_do_not_share_their_chances():
    """The same point twice, in two parts."""
    scene = mi.load_dict(small.corner())
    points = Points(np.tile(np.float32([0, 0, 1.99]), (20, 1)), np.tile(np.float32([0, 0, -1]), (20, 1)))
    first, second = round_of(Resampling(scene, transfer_of(points), 2, seed=0), 2)
    assert (first.direct() != second.direct()).mean() > 0.9
