"""Sun and sky, each sampled as often as it is bright.

Mitsuba's `sunsky` chooses between its sun and its sky as if the sun had its true size. A sun that
`sun_aperture` makes wider is hardly chosen then: of one 10 degrees wide that gives three quarters of
the light, 7 in 1000 shadow rays, each with a hundred times its share. Such an emitter is replaced by one that
emits the same light and chooses by what both give (Veach and Guibas 1995, one-sample model).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi

# The plugin that stands in for `sunsky`.
PLUGIN = "balanced_sunsky"
# What both parts take over unchanged is everything but these.
_OWN = ("to_world", "sky_scale", "sun_scale")
# Samples by which the light of each part is measured, and the fewest of all samples that a part gets.
_PROBES, _FEWEST = 1 << 14, 0.05
# As far away as no scene is large: shadow rays end there. Its square is within float32.
_DISTANCE = 1e12


def balance_xml(root: ET.Element) -> None:
    """Replaces the `sunsky` emitters of an XML scene whose sun is not of its true size, in place."""
    for emitter in root.iter("emitter"):
        names = {child.get("name") for child in emitter}
        if emitter.get("type") == "sunsky" and names & {"sun_aperture", "sunAperture"}:
            _register()
            emitter.set("type", PLUGIN)


def balanced_dictionary(description: dict[str, Any]) -> dict[str, Any]:
    """A scene dictionary in which such emitters are replaced."""
    found = dict(description)
    for name, part in description.items():
        if isinstance(part, dict) and part.get("type") == "sunsky" and "sun_aperture" in part:
            _register()
            found[name] = {**part, "type": PLUGIN}
    return found


@cache
def _register() -> None:
    """Makes the plugin known to the selected variant, of which a process has one."""

    class BalancedSunSky(mi.Emitter):  # type: ignore[misc]
        """A sun and a sky, and the share of samples that the sun gets."""

        def __init__(self, properties: mi.Properties):
            super().__init__(properties)
            self.sun, self.sky = _parts(properties)
            flux = [_flux(part) for part in (self.sun, self.sky)]
            share = flux[0] / sum(flux) if sum(flux) > 0 else 0.5
            self.share = min(max(share, _FEWEST), 1 - _FEWEST)
            self.m_flags = self.sky.flags()
            self.m_needs_sample_2 = True

        def eval(self, surface: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Color3f:
            return self.sun.eval(surface, active) + self.sky.eval(surface, active)

        def eval_direction(
            self, reference: mi.Interaction3f, found: mi.DirectionSample3f, active: mi.Bool | bool = True
        ) -> mi.Color3f:
            return self.eval(_towards(found.d), active)

        def pdf_direction(
            self, reference: mi.Interaction3f, found: mi.DirectionSample3f, active: mi.Bool | bool = True
        ) -> mi.Float:
            sun, sky = (part.pdf_direction(reference, found, active) for part in (self.sun, self.sky))
            return self.share * sun + (1 - self.share) * sky

        def sample_direction(
            self, reference: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool | bool = True
        ) -> tuple[Any, Any]:
            is_sun = sample.x < self.share
            rest = dr.select(is_sun, sample.x / self.share, (sample.x - self.share) / (1 - self.share))
            point = mi.Point2f(dr.clip(rest, 0, dr.one_minus_epsilon(mi.Float)), sample.y)
            sun, _ = self.sun.sample_direction(reference, point, active & is_sun)
            found, _ = self.sky.sample_direction(reference, point, active & ~is_sun)
            found = dr.select(is_sun, sun, found)
            # The parts do not know how large the scene is.
            found.dist = mi.Float(_DISTANCE)
            found.p = reference.p + found.d * found.dist
            found.emitter = mi.EmitterPtr(self)
            sampled = mi.Bool(active) & (found.pdf > 0)
            found.pdf = dr.select(sampled, self.pdf_direction(reference, found, sampled), 0)
            radiance = self.eval(_towards(found.d), sampled)
            return found, dr.select(found.pdf > 0, radiance / found.pdf, 0)

        def traverse(self, callback: mi.TraversalCallback) -> None:
            """Nothing of it can be changed: its share would not follow."""

        def to_string(self) -> str:
            return f"BalancedSunSky[share={self.share:.3f}]"

    mi.register_emitter(PLUGIN, BalancedSunSky)


def _parts(properties: mi.Properties) -> tuple[mi.Emitter, ...]:
    shared = {name: properties[name] for name in list(properties.keys()) if name not in _OWN}
    if "to_world" in properties:
        to_world: Any = properties["to_world"]
        shared["to_world"] = mi.ScalarTransform4f(to_world.matrix)
    sun, sky = (float(properties.get(name, 1.0)) for name in ("sun_scale", "sky_scale"))
    scales = {"sun_scale": sun, "sky_scale": 0.0}, {"sun_scale": 0.0, "sky_scale": sky}
    return tuple(mi.load_dict({**shared, "type": "sunsky", **each}) for each in scales)


def _flux(emitter: mi.Emitter) -> float:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, _PROBES)
    at = dr.zeros(mi.SurfaceInteraction3f, _PROBES)
    _, weight = emitter.sample_direction(at, sampler.next_2d(), True)
    return max(float(dr.mean(mi.luminance(weight))[0]), 0.0)


def _towards(direction: mi.Vector3f) -> mi.SurfaceInteraction3f:
    """What a ray in N directions meets that leaves the scene."""
    surface = dr.zeros(mi.SurfaceInteraction3f)
    surface.wi = -direction
    return surface
