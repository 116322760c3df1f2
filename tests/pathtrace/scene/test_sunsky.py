"""A wide sun and its sky: the same light as Mitsuba's, sampled as often as each is bright."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.extremes import extreme
from tests.placed import placed

pytestmark = pytest.mark.usefixtures("backend")

SUN = np.array([-0.6, 0.6, -0.53])
COUNT = 1 << 16
OURS = "BalancedSunSky"


def sunsky(aperture: float | None = 10.0, **more) -> dict:
    """A sun and sky, y up."""
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    wide = {} if aperture is None else {"sun_aperture": aperture}
    return {"type": "sunsky", "sun_direction": SUN.tolist(), "to_world": turned, **wide, **more}


def scene(sky: dict) -> dict:
    """The corner without its lamp, under a sky."""
    parts = {name: part for name, part in small.corner().items() if name != "lamp"}
    return {**parts, "sky": sky}


def samples(emitter) -> tuple[np.ndarray, ...]:
    """Directions, weights, densities, radiance and densities asked for, of samples of an emitter."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, COUNT)
    at = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    found, weight = emitter.sample_direction(at, sampler.next_2d(), True)
    surface = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    surface.wi = -found.d
    asked = emitter.pdf_direction(at, found, True)
    arrays = found.d, weight, found.pdf, emitter.eval(surface, True), asked
    return tuple(np.array(array, dtype=np.float64).T for array in arrays)


@pytest.fixture(scope="module")
def both() -> tuple:
    """Mitsuba's emitter and ours."""
    return mi.load_dict(sunsky()), load_scene(scene(sunsky())).mitsuba.environment()


def test_only_a_sun_of_another_size_is_replaced(both):
    assert OURS in str(both[1])
    assert OURS not in str(load_scene(scene(sunsky(None))).mitsuba.environment())


def test_its_radiance_is_that_of_mitsuba(both):
    directions = samples(both[1])[0]
    surface = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    surface.wi = -mi.Vector3f(directions.T.astype(np.float32))
    ours, theirs = (np.array(one.eval(surface, True)) for one in both[::-1])
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)


def test_samples_their_density_and_radiance_agree(both):
    _, weight, pdf, radiance, asked = samples(both[1])
    np.testing.assert_allclose(asked, pdf, rtol=1e-4)
    np.testing.assert_allclose(weight * pdf[:, None], radiance, rtol=1e-3, atol=1e-4)


def test_both_give_the_same_light_but_ours_with_less_noise(both):
    theirs, ours = (samples(one)[1].mean(axis=1) for one in both)
    error = np.hypot(theirs.std(), ours.std()) / np.sqrt(COUNT)
    assert abs(theirs.mean() - ours.mean()) < 4 * error
    assert ours.var() < 0.1 * theirs.var()


def test_a_picture_has_the_same_mean():
    """Shadow rays that end too soon would leak light, which no sample of the emitter alone shows."""
    description = scene(sunsky(3.0))
    ours = load_scene(description)
    picture = Tracer(ours).trace(ours.camera, frame_positions(ours.camera), 64, 1)
    plain = mi.render(mi.load_dict({**description, "i": {"type": "path", "max_depth": 8}}), spp=512, seed=2)
    assert np.mean(interleaved(picture.radiance)) == pytest.approx(np.mean(np.array(plain)), rel=0.03)


def test_xml_is_replaced_in_either_spelling(tmp_path):
    text = """<scene version="{}"><sensor type="perspective"><film type="hdrfilm"/></sensor>
      <shape type="sphere"/><emitter type="sunsky"><float name="{}" value="8"/>
      <vector name="{}" x="0" y="0.5" z="0.7"/></emitter></scene>"""
    for version, names in (
        ("3.0.0", ("sun_aperture", "sun_direction")),
        ("0.6.0", ("sunAperture", "sunDirection")),
    ):
        file = tmp_path / "mine.xml"
        file.write_text(text.format(version, *names))
        assert OURS in str(load_scene(file).mitsuba.environment())


@extreme(
    "a wide sun and its sky, of which one or both are dark, far away",
    given="sun_scale, sky_scale or both 0, moved by 1e6",
    expected="a finite picture, black if both are dark",
)
@pytest.mark.parametrize("dark", [(), ("sun_scale",), ("sky_scale",), ("sun_scale", "sky_scale")])
def test_dark_parts_and_far_scenes(dark, got):
    loaded = load_scene(placed(scene(sunsky(10.0, **dict.fromkeys(dark, 0.0))), 1, 1e6))
    image = interleaved(Tracer(loaded).trace(loaded.camera, frame_positions(loaded.camera), 2, 1).radiance)
    assert np.isfinite(image).all()
    assert (got(float(image.max()), ".2f") == 0) == (len(dark) == 2)
