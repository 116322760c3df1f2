"""How many views a region takes until little of it is unseen."""

from __future__ import annotations

import numpy as np

from pathtrace.region.coverage import Coverage
from pathtrace.region.region import Region
from pathtrace.scene.surfaces import Surfaces

# Side in pixels of views that tell it.
_SIDE = 256
# Views that the default region takes at first; how many that see enough is tried in these numbers.
_ORDINARY, _TRIED = 32, (32, 48, 64, 96, 128, 192, 256, 384)
_ENOUGH = 0.95
_ASKERS = 24


def breadth_of(region: Region, surfaces: Surfaces, seed: int) -> float:
    """How many times as many views as the default region a region takes until little is unseen; 1 to 12."""
    if region.name == "near":
        return 1.0
    views = region.views(_TRIED[-1], _SIDE, _SIDE, seed)
    askers = region.unseen_views(_ASKERS, _SIDE, _SIDE, seed + 1)
    coverage, before = Coverage(surfaces, []), 0
    for count in _TRIED:
        coverage.add(views[before:count])
        before = count
        if np.mean([coverage.share(view) for view in askers]) >= _ENOUGH:
            break
    return before / _ORDINARY
