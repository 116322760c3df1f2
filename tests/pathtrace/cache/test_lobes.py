"""Which share of scattered light irradiance stands for, and that nothing is counted twice."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.irradiance_cache import irradiance_share, shows_lights

pytestmark = pytest.mark.usefixtures("backend")


COUNT = 1 << 16
METAL = {"type": "roughconductor", "alpha": 0.3}


def sampled(bsdf: dict) -> tuple:
    """A surface, directions from which light comes to it, samples of where it goes, and their weights."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, COUNT)
    at, loaded = dr.zeros(mi.SurfaceInteraction3f, COUNT), mi.load_dict(bsdf)
    at.wi = dr.normalize(mi.Vector3f(0.3, 0.1, 0.9))
    sample, weight = loaded.sample(mi.BSDFContext(), at, sampler.next_1d(), sampler.next_2d())
    return loaded, at, sample, weight, sampler


def share_of_samples(bsdf: dict) -> np.ndarray:
    loaded, at, sample, _, _ = sampled(bsdf)
    density = dr.select(mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta), 0, sample.pdf)
    found = irradiance_share(loaded.flags(), at.wi, sample.wo, density)
    return np.broadcast_to(found.numpy(), COUNT)


@pytest.mark.parametrize(
    ("bsdf", "share"),
    [
        ({"type": "diffuse"}, 1.0),
        ({"type": "conductor"}, 0.0),
        ({"type": "dielectric"}, 0.0),
        ({"type": "roughconductor", "alpha": 0.6}, 0.0),
        ({"type": "roughplastic"}, None),
        ({"type": "plastic"}, None),
        ({"type": "principled", "roughness": 0.4, "specular": 0.5}, None),
    ],
    ids=lambda value: value["type"] if isinstance(value, dict) else "",
)
def test_only_diffuse_surfaces_have_a_share(bsdf, share):
    found = share_of_samples(bsdf)
    assert ((found >= 0) & (found <= 1)).all()
    if share is None:
        assert 0.1 < found.mean() < 0.99
    else:
        assert (found == share).all()


@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "roughplastic", "alpha": 0.2},
        {"type": "plastic"},
        {"type": "principled", "roughness": 0.4, "specular": 0.9, "metallic": 0.3},
        {"type": "blendbsdf", "weight": 0.4, "a": {"type": "diffuse"}, "b": METAL},
    ],
    ids=lambda bsdf: bsdf["type"],
)
def test_share_and_rest_add_up_to_all_reflected_light(bsdf):
    """Of an even light: the share by samples of the surface, the rest by directions towards the light."""
    loaded, at, sample, weight, sampler = sampled(bsdf)
    specular = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    share = irradiance_share(loaded.flags(), at.wi, sample.wo, dr.select(specular, 0, sample.pdf))
    wo = mi.warp.square_to_uniform_hemisphere(sampler.next_2d())
    value, pdf = loaded.eval_pdf(mi.BSDFContext(), at, wo)
    rest = 2 * dr.pi * value * (1 - irradiance_share(loaded.flags(), at.wi, wo, pdf))
    # No direction towards a light finds the mirror.
    mirrored = dr.select(specular, weight, 0)
    found, every = (weight * share + mirrored + rest).y.numpy(), weight.y.numpy()
    error = np.sqrt((found.var() + every.var()) / COUNT)
    assert error < 0.01 * every.mean()
    assert found.mean() == pytest.approx(every.mean(), abs=4 * float(error))


@pytest.mark.parametrize(
    ("name", "expected"),
    [("diffuse", False), ("conductor", True), ("dielectric", True), ("roughplastic", True)],
)
def test_all_but_diffuse_surfaces_may_show_lights(name, expected):
    assert shows_lights(mi.load_dict({"type": name}).flags()) is expected
