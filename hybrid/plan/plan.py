"""What a scene requires: a look at it for a few seconds, and the decisions that follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from compose.eye.display import Display
from hybrid.plan.appearance import degree_decision, frame_precision_decision
from hybrid.plan.breadth import breadth_of
from hybrid.plan.decision import Decision, Value
from hybrid.plan.detail import gaussians_decision
from hybrid.plan.layers import layers_decision
from hybrid.plan.look import Look, look_at_scene
from hybrid.plan.paths import path_decisions
from hybrid.plan.region import region_decision
from hybrid.plan.samples import sample_decisions
from hybrid.runtime.progress import no_progress
from pathtrace.region.region import NEAR, region_of
from pathtrace.scene.difficulties import light_difficulties
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces

MOTION, LIGHT = "motion", "light"
STILL, MOVING = "still", "moving"
_PARTS = 3


@dataclass(frozen=True)
class ScenePlan:
    """What a scene requires of the renderers.

    Attributes:
        scene_name, scene_hash: the scene, at its own path depth.
        decisions: one per part.
        look: that they follow from; None if it was stored.
    """

    scene_name: str
    scene_hash: str
    decisions: tuple[Decision, ...]
    look: Look | None = None

    def decision(self, name: str) -> Decision:
        """What is decided for a part, and why.

        Raises:
            KeyError: there is no such part.
        """
        return {decision.name: decision for decision in self.decisions}[name]

    def value(self, name: str) -> Any:
        """What is decided for a part.

        Raises:
            KeyError: there is no such part.
        """
        return self.decision(name).value

    def values(self) -> dict[str, Value]:
        """What is decided, by name."""
        return {decision.name: decision.value for decision in self.decisions}

    def rows(self) -> list[dict[str, Any]]:
        """As `hybrid plan --json` writes them."""
        return [decision.row() for decision in self.decisions]


def plan_of(
    scene: Scene,
    display: Display,
    size: tuple[int, int],
    region: str = NEAR,
    seed: int = 0,
    progress: Callable[[int, int], None] = no_progress,
) -> ScenePlan:
    """Looks at a scene and decides what it requires.

    Args:
        scene: the scene; afterwards, one that moves shows its first time.
        display: that frames are shown on.
        size: width and height of these frames in pixels.
        region: where viewers may be, as of pathtrace.region.
        seed: same seed, same plan on the same machine.
        progress: called with parts done and their number.

    Raises:
        UserError: the scene's own camera sees no surface, there is no such region, or no free space in it.
    """
    scene.show(0.0)
    surfaces = Surfaces(scene)
    where = region_of(scene, surfaces, region)
    breadth = breadth_of(where, surfaces, seed)
    progress(1, _PARTS)
    look = look_at_scene(scene, surfaces, where, seed)
    progress(2, _PARTS)
    decisions = (
        _motion_decision(scene),
        region_decision(region, look, breadth),
        *path_decisions(scene, look.cameras, seed),
        degree_decision(look),
        frame_precision_decision(look),
        layers_decision(display, size),
        gaussians_decision(look, breadth),
        *sample_decisions(look),
        _light_decision(scene),
    )
    progress(3, _PARTS)
    return ScenePlan(scene.name, scene.own_hash, decisions, look)


def _motion_decision(scene: Scene) -> Decision:
    """Whether there are dynamic trees, courses of motion and light, and frames of many times."""
    moving = scene.moving
    shapes = 0 if moving is None else len(moving.shapes)
    triangles = 0 if moving is None else sum(int(shape.face_count()) for shape in moving.shapes)
    evidence = {"shapes": shapes, "triangles": triangles}
    return Decision(MOTION, motion_of(scene), MOVING, evidence, 1.0, "times")


def motion_of(scene: Scene) -> str:
    """STILL or MOVING."""
    return STILL if scene.moving is None else MOVING


def _light_decision(scene: Scene) -> Decision:
    """Whether the light converges as it is, or what would help."""
    found = light_difficulties(scene)
    evidence = {"causes": {difficulty.kind: list(difficulty.causes) for difficulty in found}}
    kinds = "+".join(difficulty.kind for difficulty in found)
    return Decision(LIGHT, kinds or "plain", "plain", evidence, 1.0, "noise")
