"""What a scene requires: a look at it for a few seconds, and the decisions that follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from compose.eye.display import Display
from hybrid.plan.appearance import degree_decision, range_evidence
from hybrid.plan.decision import Decision
from hybrid.plan.layers import layers_decision
from hybrid.plan.look import Look, look_at_scene
from hybrid.plan.paths import path_decisions
from hybrid.plan.samples import denoising_decision
from hybrid.runtime.progress import no_progress
from pathtrace.scene.difficulties import light_difficulties
from pathtrace.scene.scene import Scene

_STILL, _MOVING = "still", "moving"
_PARTS = 3


@dataclass(frozen=True)
class ScenePlan:
    """What a scene requires of the renderers.

    Attributes:
        decisions: one per part.
    """

    decisions: tuple[Decision, ...]

    def value(self, name: str) -> Any:
        """What is decided for a part.

        Raises:
            KeyError: there is no such part.
        """
        return {decision.name: decision.value for decision in self.decisions}[name]

    def rows(self) -> list[dict[str, Any]]:
        """As `hybrid plan --json` writes them."""
        return [decision.row() for decision in self.decisions]


def plan_of(
    scene: Scene,
    display: Display,
    size: tuple[int, int],
    seed: int = 0,
    progress: Callable[[int, int], None] = no_progress,
) -> ScenePlan:
    """Looks at a scene and decides what it requires.

    Args:
        scene: the scene; afterwards, one that moves shows its first time.
        display: that frames are shown on.
        size: width and height of these frames in pixels.
        seed: of what is looked at; times, of which one decision depends, differ from run to run.
        progress: called with parts done and their number.

    Raises:
        UserError: the scene's own camera sees no surface, or there is no free space around it.
    """
    look = look_at_scene(scene, seed)
    progress(1, _PARTS)
    paths = path_decisions(scene, look.cameras, seed)
    progress(2, _PARTS)
    denoising = denoising_decision(scene, look.views, seed)
    scene.show(0.0)
    decisions = (
        _motion_decision(scene),
        *paths,
        degree_decision(look),
        layers_decision(display, size),
        denoising,
        _light_decision(scene, look),
    )
    progress(3, _PARTS)
    return ScenePlan(decisions)


def _motion_decision(scene: Scene) -> Decision:
    """Whether there are dynamic trees, courses of motion and light, and frames of many times."""
    moving = scene.moving
    shapes = 0 if moving is None else len(moving.shapes)
    triangles = 0 if moving is None else sum(int(shape.face_count()) for shape in moving.shapes)
    evidence = {"shapes": shapes, "triangles": triangles}
    return Decision("motion", _MOVING if shapes else _STILL, _MOVING, evidence, 1.0, "times")


def _light_decision(scene: Scene, look: Look) -> Decision:
    """Whether the light converges as it is, or what would help."""
    found = light_difficulties(scene)
    evidence = {
        "causes": {difficulty.kind: list(difficulty.causes) for difficulty in found},
        **range_evidence(look),
    }
    return Decision(
        "light", "+".join(difficulty.kind for difficulty in found) or "plain", "plain", evidence, 1.0, "noise"
    )
