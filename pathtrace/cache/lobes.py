"""Which scattered light a mean over all directions of incidence can stand for."""

from __future__ import annotations

from typing import Any

import mitsuba as mi


def reflects_irradiance(sample: Any) -> Any:
    """Whether the lobe that N sampled directions belong to reflects a share of the irradiance.

    Mirrors, glass and glossy lobes reflect what is in some directions instead: a path has to go on to it.
    Treating wide glossy lobes as diffuse was 3 % too bright beside a floor of rough metal.

    Args:
        sample: N Mitsuba BSDF samples.
    """
    return mi.has_flag(sample.sampled_type, mi.BSDFFlags.Diffuse)


def shows_lights(flags: Any) -> Any:
    """Whether surfaces have lobes that show what is in some directions: the others reflect irradiance only.

    Args:
        flags: N sets of Mitsuba BSDF flags.
    """
    return (flags & (mi.BSDFFlags.All & ~mi.BSDFFlags.Diffuse)) != 0
