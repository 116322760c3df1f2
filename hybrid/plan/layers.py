"""How many layers of a forest a display can tell apart."""

from __future__ import annotations

from compose.eye.acuity import ACUITY_MODELS, DEFAULT_ACUITY_MODEL, QUICK_ACUITY_MODEL
from compose.eye.detail import LayerRange, detail_map
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from hybrid.plan.decision import Decision

LAYERS, FIXED_LAYERS = "layers", 4
# Gazes that decide: from the corner, most of the frame is far.
_GAZES = Gaze(0.0, 0.0), Gaze(0.5, 0.5)
# Radius of the full-quality region in percent of the height: the smaller, the more is periphery.
_FOV_B = 10.0
# Gaussians of a layer over those of the next finer one.
_COARSER = 0.57
# Layers of frames that show no more detail than the finest one, in cycles per pixel.
_NYQUIST = 0.5


def layers_decision(display: Display, size: tuple[int, int]) -> Decision:
    """Layers that any gaze on a frame draws, by the acuity models of single frames and of the window.

    Args:
        display: that the frame is shown on.
        size: its width and height in pixels.
    """
    drawn = {model: _coarsest(display, size, model) for model in (DEFAULT_ACUITY_MODEL, QUICK_ACUITY_MODEL)}
    layers = FIXED_LAYERS - min(drawn.values()) + 1
    evidence = {
        "pixels_per_degree": display.pixels_per_degree,
        "least_side": min(size),
        "layers_by_model": {model: FIXED_LAYERS - coarsest + 1 for model, coarsest in drawn.items()},
    }
    total = [sum(_COARSER**step for step in range(count)) for count in (FIXED_LAYERS, layers)]
    return Decision(LAYERS, layers, FIXED_LAYERS, evidence, total[0] / total[1], "Gaussians in all layers")


def _coarsest(display: Display, size: tuple[int, int], model: str) -> int:
    """Number of the coarsest of FIXED_LAYERS layers that is drawn."""
    layers = LayerRange(_NYQUIST, (0,) * FIXED_LAYERS)
    found = FIXED_LAYERS
    for gaze in _GAZES:
        detail = detail_map(display, gaze, *size, ACUITY_MODELS[model], _FOV_B, layers)
        shown = [step.layer for number, step in enumerate(detail.steps) if (detail.weight(number) > 0).any()]
        found = min(found, *shown)
    return found
