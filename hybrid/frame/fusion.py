"""The fusion that is attached to a forest."""

from __future__ import annotations

import torch

from compose.base.errors import UserError
from compose.fusion.network import Fusion
from splat.model.forest import Forest

FUSION_PREFIX = "fusion."


def fusion_of(forest: Forest) -> Fusion | None:
    """The fusion that was fitted to a forest, None if there is none.

    Raises:
        UserError: it is of another version or damaged.
    """
    state = {
        n.removeprefix(FUSION_PREFIX): t for n, t in forest.attached.items() if n.startswith(FUSION_PREFIX)
    }
    if not state:
        return None
    fusion = Fusion()
    try:
        fusion.load_state_dict(state)
    except RuntimeError as error:
        raise UserError("the forest's fusion is damaged or of another version; train it again") from error
    if not all(bool(tensor.isfinite().all()) for tensor in state.values()):
        raise UserError("the forest's fusion holds numbers that are not finite; train it again")
    # Two thirds of the time on a CPU.
    return fusion.requires_grad_(False).eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
