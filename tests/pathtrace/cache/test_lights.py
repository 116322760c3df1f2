"""Choice of lights: chances by what lights give, and the same light as from Mitsuba's own choice."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.cells import Grid, Points
from pathtrace.cache.light_selection import LightChoice, LightLearning, Lights, LightSamples, light_numbers
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
GRID = Grid(np.zeros(3, dtype=np.float32), 1.0)
NEAR, FAR = np.float32([0.1, 0, 0.1]), np.float32([5, 0, 5])
UP = np.float32([0, 1, 0])


def lamp(x: float, power: float) -> dict:
    place = mi.ScalarTransform4f().translate([x, 2, 0]).rotate([1, 0, 0], 90).scale(0.3)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": power}}
    return {"type": "rectangle", "to_world": place, "emitter": emitter}


def lit_floor() -> dict:
    return {
        "type": "scene",
        "a": lamp(-1, 5.0),
        "b": lamp(1, 20.0),
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.2}},
        "spot": {"type": "point", "position": [0, 3, 1], "intensity": {"type": "rgb", "value": 4.0}},
        "board": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0.6, 1, 0]).rotate([1, 0, 0], 90).scale(0.4),
        },
    }


def choice(lights: int = 4) -> LightChoice:
    """In the cell at NEAR, light 0 gives three times as much as light 1, and the others nothing."""
    count = 400 * lights
    light = np.arange(count) % lights
    irradiance = np.select([light == 0, light == 1], [3.0, 1.0], 0.0).astype(np.float32)
    samples = LightSamples(np.zeros(count, dtype=int), light, irradiance)
    points = Points(np.stack([NEAR, FAR]), np.stack([UP, UP]))
    return LightChoice.of(samples, points, GRID, lights)


def test_chances_follow_what_lights_give_and_miss_none():
    chances = choice().chances
    assert chances.shape == (2, 4)
    np.testing.assert_allclose(chances.sum(axis=1), 1, rtol=1e-6)
    assert (chances > 0.04).all()
    learnt = chances[0] - chances[0, 3]
    assert learnt[0] == pytest.approx(3 * learnt[1], rel=1e-4)


def test_rows_are_those_of_the_cells_and_the_last_elsewhere():
    points = Points(np.stack([FAR, NEAR, NEAR, NEAR]), np.stack([UP, UP, -UP, UP]))
    np.testing.assert_array_equal(choice().rows(points), [1, 0, 1, 0])


def test_new_samples_replace_a_choice_little_by_little():
    before = choice()
    learning = LightLearning(before)
    np.testing.assert_array_equal(learning.choice().chances, before.chances)
    seen = []
    for _ in range(4):
        light = np.arange(128) % 4
        irradiance = np.where(light == 3, 2.0, 0.0).astype(np.float32)
        learning.add(LightSamples(np.arange(128) % 2, light, irradiance), np.array([0, 0]))
        seen.append(learning.choice().chances)
        np.testing.assert_allclose(seen[-1].sum(axis=1), 1, rtol=1e-5)
    # 256 samples are enough for a cell; all samples count for the other places.
    assert before.chances[0, 3] < seen[0][0, 3] < seen[1][0, 3]
    np.testing.assert_allclose(seen[1][0], [0.05, 0.05, 0.05, 0.85], rtol=1e-5)
    np.testing.assert_allclose(seen[3], seen[1], rtol=1e-5)
    np.testing.assert_array_equal(learning.choice().keys, before.keys)


def test_few_samples_or_no_light_give_equal_or_common_chances():
    few = LightSamples(np.zeros(20, dtype=int), np.zeros(20, dtype=int), np.ones(20, dtype=np.float32))
    points = Points(NEAR[None], UP[None])
    assert len(LightChoice.of(few, points, GRID, 4).keys) == 0
    dark = LightSamples(few.point, few.light, np.zeros(20, dtype=np.float32))
    np.testing.assert_allclose(LightChoice.of(dark, points, GRID, 4).chances, [[0.25] * 4])


def test_rows_are_those_of_the_cells():
    scene = mi.load_dict(lit_floor())
    lights = Lights(scene, choice().arrays(scene))
    position = mi.Point3f(np.stack([NEAR, FAR, NEAR]).T)
    side = mi.Normal3f(np.stack([UP, UP, -UP]).T)
    assert lights.row(position, side, mi.Bool(True)).numpy().tolist() == [0, 1, 1]


def test_numbers_of_lights_are_their_places_in_the_scene():
    scene = mi.load_dict(lit_floor())
    registered = dr.reinterpret_array(mi.UInt32, scene.emitters_dr()).numpy()
    assert light_numbers(scene)[registered].tolist() == list(range(4))


def irradiance(sample, scene, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance samples of a point on the floor, and the densities of their directions."""
    random = mi.load_dict({"type": "independent"})
    random.seed(1, count)
    at = dr.zeros(mi.SurfaceInteraction3f, count)
    at.p, at.n, at.t = mi.Point3f(*NEAR.tolist()), mi.Normal3f(0, 1, 0), mi.Float(1)
    at.sh_frame = mi.Frame3f(at.n)
    light, emitted = sample(at, random.next_2d())
    values = dr.select(light.pdf > 0, emitted.x * dr.maximum(light.d.y, 0), 0)
    return values.numpy(), light


def test_light_is_that_of_mitsubas_choice_and_densities_agree():
    scene, count = mi.load_dict(lit_floor()), 1 << 16
    lights = Lights(scene, choice().arrays(scene))
    row = mi.UInt32(0)

    def shadowed(at, point):
        light, emitted = lights.sample(at, row, point, mi.Bool(True))
        return light, lights.arriving(at, light, emitted, light.pdf > 0)

    own, light = irradiance(shadowed, scene, count)
    other, _ = irradiance(lambda at, point: scene.sample_emitter_direction(at, point, True), scene, count)
    error = float(np.sqrt(own.var() / count + other.var() / count))
    assert own.mean() == pytest.approx(other.mean(), abs=4 * error)
    assert error < 0.02 * other.mean()
    at = dr.zeros(mi.SurfaceInteraction3f, count)
    at.p = mi.Point3f(*NEAR.tolist())
    density = lights.pdf(at, row, light, light.pdf > 0).numpy()
    extended = (light.pdf.numpy() > 0) & ~light.delta.numpy()
    np.testing.assert_allclose(density[extended], light.pdf.numpy()[extended], rtol=1e-3)


def test_each_light_is_chosen_as_often_as_its_chance_says():
    scene, count = mi.load_dict(lit_floor()), 1 << 16
    chosen = choice()
    lights = Lights(scene, chosen.arrays(scene))
    _, light = irradiance(
        lambda at, point: lights.sample(at, mi.UInt32(0), point, mi.Bool(True)), scene, count
    )
    number = light_numbers(scene)[dr.reinterpret_array(mi.UInt32, light.emitter).numpy()]
    share = np.bincount(number, minlength=4) / count
    np.testing.assert_allclose(share, chosen.chances[0], atol=5 * np.sqrt(0.25 / count))


def test_unused_random_numbers_stay_uniform():
    """The part of a random number that did not choose the light places the sample on it."""
    scene, count = mi.load_dict({"type": "scene", "a": lamp(-1, 5.0), "b": lamp(1, 20.0)}), 1 << 14
    lights = Lights(scene, choice(2).arrays(scene))
    at = dr.zeros(mi.SurfaceInteraction3f, count)
    at.p, at.n = mi.Point3f(*NEAR.tolist()), mi.Normal3f(0, 1, 0)
    at.sh_frame, at.t = mi.Frame3f(at.n), mi.Float(1)
    x = (dr.arange(mi.Float, count) + 0.5) / count
    light, _ = lights.sample(at, mi.UInt32(0), mi.Point2f(x, 0.5), mi.Bool(True))
    number = light_numbers(scene)[dr.reinterpret_array(mi.UInt32, light.emitter).numpy()]
    for lamps in (0, 1):
        spread = np.ptp(light.p.numpy().T[number == lamps], axis=0).max()
        assert spread == pytest.approx(0.6, rel=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_chances_are_in_proportion_to_root_mean_squares(seed):
    random = small.rng(seed)
    light = random.integers(0, 3, 3000)
    irradiance = (random.uniform(0, 1, 3000) * (light + 1)).astype(np.float32)
    samples = LightSamples(np.zeros(3000, dtype=int), light, irradiance)
    chances = LightChoice.of(samples, Points(NEAR[None], UP[None]), GRID, 3).chances[0]
    roots = np.array([np.sqrt((irradiance[light == k].astype(float) ** 2).sum()) for k in range(3)])
    even = 0.2 / 3
    np.testing.assert_allclose((chances - even) / 0.8, roots / roots.sum(), rtol=1e-4)
