"""The steps in which detail falls towards the edges: layers of a forest, each at a sampling rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

COARSEST_RATE = 4  # log2 of pixels per sample along each axis


@dataclass(frozen=True)
class Step:
    """A layer at a rate, and where it begins to be drawn.

    Attributes:
        octaves: log2 of the pixels per cycle of the cut-off at which it begins to fade in.
        layer: 1, the coarsest, to L.
        rate: log2 of pixels per sample along each axis.
    """

    octaves: float
    layer: int
    rate: int


def detail_steps(
    finest: float, ahead: float, finest_rates: tuple[int, ...], lowest: int, fade: float
) -> tuple[Step, ...]:
    """What is drawn as the cut-off falls: layer after layer, each at one rate.

    A layer fades into the next one just before the boundary of its level, where Fov-GS's Eq. 7 steps down:
    at the edge of the full-quality region the second layer is drawn alone. The rate changes with the layer,
    to the coarsest one that still carries what the cut-off lets through there. It changes on its own only
    where one layer serves several octaves, as the finest and the coarsest do.

    Args:
        finest: the cut-off, in cycles per pixel, down to which layer L is required.
        ahead: the same for a viewer who looks straight ahead. Rates follow from it, because they must not
            change with the gaze: a whole layer would pop.
        finest_rates: finest rate that is worth its samples, for each of layers 1 to L.
        lowest: coarsest layer that may be drawn.
        fade: fraction of an octave over which a step fades in.

    Returns:
        Steps from fine to coarse; the first one has no beginning.
    """
    layers = len(finest_rates)
    steps = [Step(-np.inf, layers, finest_rates[-1])]
    first = -np.log2(finest) - fade if lowest < layers else np.inf
    # A rate carries frequencies up to half its samples: rate r begins at 1 + r octaves.
    for rate in range(steps[0].rate + 1, COARSEST_RATE + 1):
        if lowest == layers or 1 + rate + fade <= -np.log2(ahead) - fade:
            steps.append(Step(1.0 + rate, layers, rate))
    for layer in range(layers - 1, lowest - 1, -1):
        below = layers - 1 - layer
        carried = min(int(np.floor(below - np.log2(ahead) - 1)), COARSEST_RATE)
        steps.append(Step(first + below, layer, max(carried, steps[-1].rate, finest_rates[layer - 1])))
    for rate in range(steps[-1].rate + 1, COARSEST_RATE + 1):
        steps.append(Step(max(1.0 + rate, steps[-1].octaves + fade), lowest, rate))
    return tuple(steps)
