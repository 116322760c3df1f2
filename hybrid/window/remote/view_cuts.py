"""The cut of a forest that a viewer's frame calls for, as the server finds it."""

from __future__ import annotations

from dataclasses import replace

from compose.base.errors import UserError
from compose.eye.acuity import acuity_model_named
from compose.eye.detail import LayerRange, detail_map
from hybrid.base.compute_device import device_arrays
from hybrid.render.frame_settings import MOST_LEVEL, FrameSettings
from hybrid.render.periphery import continuous_levels
from hybrid.window.remote.protocol import ViewMessage
from splat.model.forest import Forest
from splat.model.points import Bits
from splat.raster.cut import CompleteCuts

# Cut-offs do not depend on what layers there are.
_LAYERS = LayerRange(1.0, (0,))


def with_hierarchy(forest: Forest) -> Forest:
    """The forest with its hierarchy and nothing else that splats alone are drawn without.

    Raises:
        UserError: something moves in it.
    """
    if forest.motion is not None or forest.light is not None:
        raise UserError(f"something moves in the forest of {forest.scene_name}; only still ones are served")
    return replace(forest, attached={}, hierarchy=forest.own_hierarchy)


class ViewCuts:
    """Cuts of a forest in which nothing moves.

    Args:
        forest: what is drawn.
        settings: level, acuity model, and how many Gaussians a cut has at most, of all directions.
    """

    def __init__(self, forest: Forest, settings: FrameSettings):
        self._place, self._level, self._most = forest.place, settings.level or 1.0, settings.gaussians
        self._model = acuity_model_named(settings.acuity_model)
        self._cuts = CompleteCuts(device_arrays(), forest.hierarchy_nodes)
        self.tree = self._cuts.tree

    def split(self, view: ViewMessage, before: Bits | None) -> tuple[Bits, float]:
        """Which inner nodes (M,) are split for a view, and the level that this is for.

        Most of what was split `before` stays.
        """
        camera = view.camera
        size = camera.width, camera.height
        detail = detail_map(view.display, view.gaze, *size, self._model, 0.0, _LAYERS)
        levels = continuous_levels(self._level, detail.cutoff)
        split, factor = self._cuts.split(self._place.camera(camera), levels, self._most, before)
        return split, min(self._level * factor, MOST_LEVEL)
