"""What a forest's file carries for the renderer: plan, training views, expected errors."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from compose.base.errors import UserError
from compose.camera.camera import Camera
from pathtrace.scene.scene import DEPTH, ROULETTE, Scene
from pathtrace.trace.path_depths import UNBOUNDED
from splat.model.forest import ABOUT, Forest

# Names of what is attached: the plan, the table of views, errors, seconds.
_PLAN, _VIEWS, _ERRORS = "plan.json", "views.cameras", "errors.coarsest"
_SECONDS = ABOUT + "seconds"
# Of each view width, height, focal lengths and principal point, then the world-to-camera transform.
_NUMBERS = 6 + 16


def attach_plan(forest: Forest, values: Mapping[str, Any]) -> Forest:
    """The forest with what was planned for it attached; as it is if nothing was."""
    if not values:
        return forest
    text = json.dumps(dict(values), sort_keys=True).encode()
    content = torch.from_numpy(np.frombuffer(text, dtype=np.uint8).copy())
    return replace(forest, attached={**forest.attached, _PLAN: content})


def plan_of_forest(forest: Forest) -> dict[str, Any]:
    """What was planned for a forest, by name; empty if it does not say, UserError if that is damaged."""
    content = forest.attached.get(_PLAN)
    if content is None:
        return {}
    try:
        values = json.loads(content.numpy().tobytes())
        return {str(name): value for name, value in values.items()}
    except (ValueError, AttributeError, TypeError) as error:
        raise UserError("the forest's plan is damaged; train the forest again") from error


def scene_as_trained(scene: Scene, forest: Forest) -> Scene:
    """The scene with the paths that a forest was planned with, if none are planned for the scene itself.

    A scene's hash depends on its path depth: without a plan, it would not be that of the forest. The scene is
    as it was if it has a plan, if the forest has none, or if the forest does not belong to it even so.
    """
    plan = {} if scene.plan else plan_of_forest(forest)
    depth, roulette = plan.get(DEPTH), plan.get(ROULETTE)
    if not isinstance(depth, int) or not isinstance(roulette, int):
        return scene
    planned = scene.planned(plan)
    is_possible = roulette >= 1 and (depth >= 1 or depth == UNBOUNDED)
    return planned if is_possible and planned.hash == forest.scene_hash else scene


def attach_views(forest: Forest, cameras: Sequence[Camera]) -> Forest:
    """The forest with the views that it was trained on attached, in the coordinates of its frame set."""
    rows = [np.frombuffer(camera.key, dtype=np.float64) for camera in cameras]
    table = torch.from_numpy(np.array(rows).reshape(-1, _NUMBERS))
    return replace(forest, attached=forest.attached | {_VIEWS: table})


def own_views(forest: Forest) -> list[Camera]:
    """What `views_of` returns, in the coordinates of the forest's nodes."""
    return [forest.place.camera(view) for view in views_of(forest)]


def views_of(forest: Forest) -> list[Camera]:
    """The views that a forest was trained on; none if it does not say, UserError if they are damaged."""
    table = forest.attached.get(_VIEWS)
    if table is None:
        return []
    try:
        if table.dtype != torch.float64 or table.shape[1:] != (_NUMBERS,):
            raise ValueError(f"{table.dtype} of shape {tuple(table.shape)}")
        return [Camera.of_key(row.tobytes()) for row in table.numpy()]
    except (ValueError, OverflowError) as error:
        raise UserError(
            f"the forest's training views are damaged ({error}); train the forest again"
        ) from error


# Errors are stored in steps of an eighth of an octave below 1; the last one, 3e-10, counts as none.
_STEPS_PER_OCTAVE, _NO_ERROR = 8, 255


def attach_errors(forest: Forest, errors: torch.Tensor) -> Forest:
    """The forest with the squared errors to expect where nodes (N,) of its coarsest layer show.

    They are of sRGB values from 0 to 1, stored in a byte each.
    """
    steps = torch.round(-_STEPS_PER_OCTAVE * torch.log2(errors)).clamp(0, _NO_ERROR)
    return replace(forest, attached=forest.attached | {_ERRORS: steps.to(torch.uint8)})


def errors_of(forest: Forest) -> torch.Tensor | None:
    """(N,) float32, the squared errors that are attached to a forest; None if there are none.

    UserError if they are damaged.
    """
    steps = forest.attached.get(_ERRORS)
    if steps is None:
        return None
    if steps.dtype != torch.uint8 or steps.shape != (forest.counts[0],):
        raise UserError("the forest's expected errors are damaged; train the forest again")
    return torch.where(steps == _NO_ERROR, 0.0, torch.exp2(steps.float() / -_STEPS_PER_OCTAVE))


def attach_seconds(forest: Forest, seconds: float) -> Forest:
    """The forest with the time that its preparation took."""
    return replace(
        forest, attached=forest.attached | {_SECONDS: torch.tensor([seconds], dtype=torch.float64)}
    )


def seconds_of(forest: Forest) -> float | None:
    """The seconds that the preparation of a forest took; None if it does not say."""
    found = forest.attached.get(_SECONDS)
    return None if found is None or found.numel() != 1 else float(found)
