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
# Precision of the frames that a training keeps in memory. The first one holds radiance up to 65,504 in steps
# finer than those of a 10-bit display; a look misses what is brighter and small.
FRAME_PRECISION, HALF, SINGLE = "frame precision", "float16", "float32"
_LARGEST_IN_HALF = 16_000.0


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


def frame_precision_decision(look: Look) -> Decision:
    """The precision of frames in memory, by how far radiance ranges.

    Its evidence is factors of two between dark and bright pixels, and the largest radiance of a channel.
    """
    shown = np.concatenate([luminance(image).ravel() for image in look.radiance])
    largest = max((float(image.max(initial=0)) for image in look.radiance), default=0.0)
    lit = shown[shown > 0]
    stops = float(np.log2(np.divide(*np.quantile(lit, [_MOST, _LEAST])))) if len(lit) else 0.0
    precision = HALF if largest <= _LARGEST_IN_HALF else SINGLE
    evidence = {"stops": stops, "largest": largest}
    gain = 2.0 if precision == HALF else 1.0
    return Decision(FRAME_PRECISION, precision, SINGLE, evidence, gain, "memory of frames")
