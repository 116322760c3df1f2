"""What a forest's file carries for the renderer: the fusion network, and the views it was trained on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from compose.base.errors import UserError
from compose.base.files import under
from compose.camera.camera import Camera
from compose.fusion.network import Fusion
from splat.model.forest import Forest

# Names of what is attached: a prefix for the network's state, and the table of views.
_FUSION, _VIEWS = "fusion.", "views.cameras"
# Of each view width, height, focal lengths and principal point, then the world-to-camera transform.
_NUMBERS = 6 + 16


def attach_fusion(forest: Forest, fusion: Fusion) -> Forest:
    """The forest with a fitted network attached, which its file then contains."""
    state = {_FUSION + name: tensor.clone() for name, tensor in fusion.state_dict().items()}
    return replace(forest, attached=forest.attached | state)


def fusion_of(forest: Forest) -> Fusion | None:
    """The network that is attached to a forest; None if there is none.

    Raises:
        UserError: the network is damaged or of another version.
    """
    state = under(_FUSION, forest.attached)
    if not state:
        return None
    fusion = Fusion()
    try:
        fusion.load_state_dict(state)
    except RuntimeError as error:
        raise UserError(
            "the forest's fusion network is damaged or of another version; train the forest again"
        ) from error
    if not all(bool(tensor.isfinite().all()) for tensor in state.values()):
        raise UserError("the forest's fusion network has weights that are not finite; train the forest again")
    # On a CPU this layout takes two thirds of the time of contiguous weights.
    fusion = fusion.requires_grad_(False).eval()
    return fusion.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def attach_views(forest: Forest, cameras: Sequence[Camera]) -> Forest:
    """The forest with the views that it was trained on attached, in the coordinates of its frame set."""
    rows = [np.frombuffer(camera.key, dtype=np.float64) for camera in cameras]
    table = torch.from_numpy(np.array(rows).reshape(-1, _NUMBERS))
    return replace(forest, attached=forest.attached | {_VIEWS: table})


def views_of(forest: Forest) -> list[Camera]:
    """The views that a forest was trained on; none if it does not say.

    Raises:
        UserError: the views are damaged.
    """
    table = forest.attached.get(_VIEWS)
    if table is None:
        return []
    try:
        if table.dtype != torch.float64 or table.shape[1:] != (_NUMBERS,):
            raise ValueError(f"{table.dtype} of shape {tuple(table.shape)}")
        return [
            Camera(row[6:].reshape(4, 4).copy(), int(row[0]), int(row[1]), *row[2:6].tolist())
            for row in table.numpy()
        ]
    except (ValueError, OverflowError) as error:
        raise UserError(
            f"the forest's training views are damaged ({error}); train the forest again"
        ) from error
