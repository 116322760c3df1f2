"""Which lobes reflect a share of the irradiance."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.lobes import reflects_irradiance, shows_lights

pytestmark = pytest.mark.usefixtures("backend")


@pytest.mark.parametrize(
    ("bsdf", "share"),
    [
        ({"type": "diffuse"}, 1.0),
        ({"type": "conductor"}, 0.0),
        ({"type": "dielectric"}, 0.0),
        ({"type": "roughconductor", "alpha": 0.6}, 0.0),
        ({"type": "roughplastic"}, None),
        ({"type": "plastic"}, None),
    ],
    ids=lambda value: value["type"] if isinstance(value, dict) else "",
)
def test_only_diffuse_lobes_do(bsdf, share):
    count = 1000
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, count)
    at = dr.zeros(mi.SurfaceInteraction3f, count)
    at.wi = dr.normalize(mi.Vector3f(0.3, 0.1, 0.9))
    loaded = mi.load_dict(bsdf)
    sample, _ = loaded.sample(mi.BSDFContext(), at, sampler.next_1d(), sampler.next_2d())
    found = np.broadcast_to(reflects_irradiance(sample).numpy(), count).mean()
    if share is None:
        assert 0.1 < found < 0.99
    else:
        assert found == share


@pytest.mark.parametrize(
    ("name", "expected"),
    [("diffuse", False), ("conductor", True), ("dielectric", True), ("roughplastic", True)],
)
def test_all_but_diffuse_surfaces_may_show_lights(name, expected):
    assert shows_lights(mi.load_dict({"type": name}).flags()) is expected
