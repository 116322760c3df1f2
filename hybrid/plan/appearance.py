"""Whether radiance depends on the direction it is seen from, and how far it ranges."""

from __future__ import annotations

import numpy as np

from compose.image.colour import luminance
from compose.image.gloss import DIFFUSE, SPECULAR
from hybrid.plan.decision import Decision
from hybrid.plan.look import Look
from splat.model.gaussians import MAX_DEGREE, sh_count

# Share of the pixels that must show gloss for Gaussians to have directional harmonics, and their degree where
# they do; of the degree above, `room` gains next to nothing.
_LEAST_GLOSS, _DEGREE = 0.002, 2
DEGREE = "degree"
# Shares of the pixels between which radiance is said to range.
_LEAST, _MOST = 0.01, 0.999


def degree_decision(look: Look) -> Decision:
    """The degree of the spherical harmonics."""
    gloss = np.concatenate([classes.ravel() for classes in look.gloss])
    reflected = np.concatenate([mask.ravel() for mask in look.reflected])
    turns = (gloss != DIFFUSE) | reflected
    share = float(turns.mean())
    degree = _DEGREE if share > _LEAST_GLOSS and not look.is_one_point else 0
    evidence = {
        "turning": share,
        "is_one_point": look.is_one_point,
        "specular": float(((gloss == SPECULAR) | reflected).mean()),
        "least": _LEAST_GLOSS,
    }
    gain = sh_count(MAX_DEGREE) / sh_count(degree)
    return Decision(DEGREE, degree, MAX_DEGREE, evidence, gain, "harmonics per Gaussian")


def range_evidence(look: Look) -> dict[str, float]:
    """How far radiance ranges: factors of two between dark and bright pixels, and the largest radiance."""
    shown = np.concatenate([luminance(image).ravel() for image in look.radiance])
    lit = shown[shown > 0]
    if not len(lit):
        return {"stops": 0.0, "largest": 0.0}
    low, high = np.quantile(lit, [_LEAST, _MOST])
    return {"stops": float(np.log2(high / low)), "largest": float(lit.max())}
