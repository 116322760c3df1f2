"""What of a change over time the eye sees: sensitivity to flicker, from the fovea to 60 degrees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Of `flicker_sensitivity`, in the order of its text; the gain is that of Cai et al.'s own measurements.
FLICKER = (2.1702, 28.78, 0.03622, 0.003836, 0.2084, 0.02561, 0.7975)
# Stages of the two filters, and the time constant of the second one over that of the first (Watson 1986).
_STAGES, _LATER = (9, 10), 1.33
# Speed below which the formula says nothing any more, where it is too dark.
_SLOWEST = 0.05


def flicker_sensitivity(
    frequency: Array,
    eccentricity: Array | float,
    luminance: Array | float,
    area: Array | float,
    parameters: tuple[float, ...] = FLICKER,
) -> Array:
    """Sensitivity, 1 / contrast at threshold, to an area whose luminance changes at a frequency.

    The response to a frequency is that of two low-pass filters, the second subtracted (Watson 1986, Handbook
    of Perception 1, ch. 6). It is as much faster as the logarithm of the luminance grows (Ferry and Porter),
    and with eccentricity. Sensitivity grows with the root of the area up to a critical one, and falls with
    eccentricity: the fastest flicker is seen aside, the least contrast in the fovea. That the fastest of
    small areas is seen in the fovea, too (Hartmann et al. 1979), is not modelled. Fitted by
    `python -m benchmarks.fit_flicker` to 460 thresholds of eight studies from 1 cd/m2 on, 163 of them off the
    fovea, each study with a factor of its own, as elaTCSF was made (Cai et al. 2024).

    Frequency is in Hz, eccentricity in degrees, luminance in cd/m2, the area in square degrees; all over 0
    but for eccentricity. Parameters are log10 of the gain, the critical area, what log10 of the sensitivity
    loses per degree, a time constant in seconds, by how much time runs faster for each factor of 10 over 100
    cd/m2 and for each degree, and the weight of the second filter.
    """
    gain, critical, fall, constant, per_decade, per_degree, weight = parameters
    speed = (1 + per_decade * np.log10(np.asarray(luminance) / 100)) * (1 + per_degree * eccentricity)
    turns = 2j * np.pi * frequency * constant / np.maximum(speed, _SLOWEST)
    response = np.abs((1 + turns) ** -_STAGES[0] - weight * (1 + _LATER * turns) ** -_STAGES[1])
    summed = np.sqrt(critical * np.asarray(area) / (critical + area))
    found: Array = 10 ** (gain - fall * eccentricity) * summed * response
    return found
