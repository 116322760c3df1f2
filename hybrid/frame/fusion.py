"""The fusion network that a forest carries."""

from __future__ import annotations

from dataclasses import replace

import torch

from compose.base.errors import UserError
from compose.base.named import under
from compose.fusion.network import Fusion
from splat.model.forest import Forest

_PREFIX = "fusion."


def attach_fusion(forest: Forest, fusion: Fusion) -> Forest:
    """The forest with a fitted network attached, which its file then contains."""
    state = {_PREFIX + name: tensor.clone() for name, tensor in fusion.state_dict().items()}
    return replace(forest, attached={**forest.attached, **state})


def fusion_of(forest: Forest) -> Fusion | None:
    """The network that is attached to a forest; None if there is none.

    Raises:
        UserError: the network is damaged or of another version.
    """
    state = under(_PREFIX, forest.attached)
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
