"""What a plan decides, by name; as files of frames and forests have it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from compose.base.errors import UserError
from hybrid.plan.decision import Value
from hybrid.plan.plan import MOTION, motion_of
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

_NAME = "plan.json"


def attach_plan(forest: Forest, values: Mapping[str, Value]) -> Forest:
    """The forest with what was planned for it attached; as it is if nothing was."""
    if not values:
        return forest
    text = json.dumps(dict(values), sort_keys=True).encode()
    content = torch.from_numpy(np.frombuffer(text, dtype=np.uint8).copy())
    return replace(forest, attached={**forest.attached, _NAME: content})


def plan_of_forest(forest: Forest) -> dict[str, Value]:
    """What was planned for a forest, by name; empty if it does not say.

    Raises:
        UserError: what it says is damaged.
    """
    content = forest.attached.get(_NAME)
    if content is None:
        return {}
    try:
        values = json.loads(content.numpy().tobytes())
        return {str(name): value for name, value in values.items()}
    except (ValueError, AttributeError, TypeError) as error:
        raise UserError("the forest's plan is damaged; train the forest again") from error


def require_plan(values: Mapping[str, Any], scene: Scene, source: object) -> None:
    """Checks that a plan does not contradict the scene that it is used with.

    Args:
        values: what it decides, by name.
        scene: the scene.
        source: where the plan comes from, for the message.

    Raises:
        UserError: something moves in a scene planned as still, or the other way round.
    """
    planned, fact = values.get(MOTION, motion_of(scene)), motion_of(scene)
    if planned != fact:
        raise UserError(f"{source}: its plan has {MOTION} {planned}, but {scene.name} has {fact}")
