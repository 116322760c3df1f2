"""What a scene requires: the plan that follows from a look at it for a few seconds.

It is stored in the cache folder, is a part of frame sets and forests, and a user may decide items instead.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from compose.base.files import json_text, read_json, write_whole
from compose.eye.display import DISPLAYS, Display
from hybrid.base.cache_folder import scene_folder
from hybrid.base.progress import Bar, Bars, no_bars, no_progress
from hybrid.preparation.decisions import (
    DEGREE,
    DENOISED,
    DENOISING,
    FRAME_PRECISION,
    HALF,
    LAYERS,
    RAW,
    SAMPLES,
    SINGLE,
    Decision,
    Value,
    degree_decision,
    frame_precision_decision,
    layers_decision,
    path_decisions,
    region_decision,
    sample_decisions,
)
from hybrid.preparation.gaussian_count import GAUSSIANS, breadth_of, gaussians_decision
from hybrid.preparation.scene_look import VIEWS, Look, look_at_scene
from hybrid.render.frame_settings import MOST_SPP
from pathtrace.region import NEAR, region_of
from pathtrace.scene.optics import light_difficulties
from pathtrace.scene.scene import DEPTH, ROULETTE, Scene, load_scene
from splat.model.gaussians import MAX_DEGREE

_LOG = logging.getLogger("hybrid")
MOTION, LIGHT = "motion", "light"
STILL, MOVING = "still", "moving"
# Of a plan: its views, the look at each, and three measurements.
_PARTS = 1 + VIEWS + 3


@dataclass(frozen=True)
class ScenePlan:
    """What a scene requires of the renderers."""

    scene_name: str
    scene_hash: str  # at its own path depth
    decisions: tuple[Decision, ...]  # one per part
    look: Look | None = None  # that they follow from; None if it was stored

    def decision(self, name: str) -> Decision:
        """What is decided for a part, and why; KeyError if there is no such part."""
        return {decision.name: decision for decision in self.decisions}[name]

    def values(self) -> dict[str, Value]:
        """What is decided, by name."""
        return {decision.name: decision.value for decision in self.decisions}

    def rows(self) -> list[dict[str, Any]]:
        """As `hybrid plan --json` writes them."""
        return [asdict(decision) for decision in self.decisions]


def plan_of(
    scene: Scene,
    display: Display,
    size: tuple[int, int],
    region: str = NEAR,
    seed: int = 0,
    progress: Bar = no_progress,
) -> ScenePlan:
    """Looks at a scene and decides what it requires; afterwards, one that moves shows its first time.

    Args:
        display, size: what frames are shown on, and their width and height in pixels.
        region: where viewers may be (pathtrace.region).
        seed: same seed, same plan on the same machine.
        progress: called with parts done, their number, and what comes next.

    Raises:
        UserError: the scene's own camera sees no surface, there is no such region, or no free space in it.
    """
    scene.show(0.0)
    progress(0, _PARTS, "choosing views")
    surfaces = scene.surfaces()
    where = region_of(scene, surfaces, region)
    breadth = breadth_of(where, surfaces, seed)
    tell = lambda done: progress(1 + done, _PARTS, "looking at the scene")  # noqa: E731
    look = look_at_scene(scene, surfaces, where, seed, tell)
    progress(1 + VIEWS, _PARTS, "measuring paths")
    paths = path_decisions(scene, [view.camera for view in look.views], seed)
    progress(2 + VIEWS, _PARTS, "measuring noise")
    samples = sample_decisions(look)
    progress(3 + VIEWS, _PARTS, "counting Gaussians")
    gaussians = gaussians_decision(look, breadth, scene.moving is not None)
    # Whether there are dynamic trees, courses of motion and light, and frames of many times.
    shapes = [] if scene.moving is None else scene.moving.shapes
    moves = {"shapes": len(shapes), "triangles": sum(int(shape.face_count()) for shape in shapes)}
    # Whether the light converges as it is, or what would help.
    found = light_difficulties(scene)
    causes = {difficulty.kind: list(difficulty.causes) for difficulty in found}
    kinds = "+".join(difficulty.kind for difficulty in found)
    decisions = (
        Decision(MOTION, motion_of(scene), MOVING, moves, 1.0, "times"),
        region_decision(region, look, breadth),
        *paths,
        degree_decision(look),
        frame_precision_decision(look),
        layers_decision(display, size),
        gaussians,
        *samples,
        Decision(LIGHT, kinds or "plain", "plain", {"causes": causes}, 1.0, "noise"),
    )
    progress(_PARTS, _PARTS)
    return ScenePlan(scene.name, scene.own_hash, decisions, look)


def motion_of(scene: Scene) -> str:
    """STILL or MOVING."""
    return STILL if scene.moving is None else MOVING


def require_plan(values: Mapping[str, Any], scene: Scene, source: object) -> None:
    """Checks that a plan's values do not contradict the scene it is used with; the message names its source.

    Raises:
        UserError: something moves in a scene planned as still, or the other way round.
    """
    planned, fact = values.get(MOTION, motion_of(scene)), motion_of(scene)
    if planned != fact:
        raise UserError(f"{source}: its plan has {MOTION} {planned}, but {scene.name} has {fact}")


_VERSION = 4
# Of frames where nothing else is asked for.
DISPLAY, SIZE = "desktop", (1920, 1080)


def scene_as_stored(
    source: str | Path | dict[str, Any],
    max_depth: int | None = None,
    thin_glass: bool = False,
    motion: Path | None = None,
    sensor: str | None = None,
) -> Scene:
    """Loads a scene like `load_scene`, and as its stored plan has it if there is one; a given depth stays.

    Raises:
        UserError: as in `load_scene`, or the stored plan contradicts the scene.
    """
    scene = load_scene(source, max_depth, thin_glass, motion, sensor)
    plan = _stored(scene)
    return scene if plan is None else scene.planned(plan.values())


def planned_scene(
    source: str | Path | dict[str, Any],
    max_depth: int | None = None,
    thin_glass: bool = False,
    sensor: str | None = None,
    bars: Bars = no_bars,
    override: Mapping[str, Value] | None = None,
) -> Scene:
    """Loads a scene like `load_scene`, and as its plan has it (`as_planned`)."""
    return as_planned(load_scene(source, max_depth, thin_glass, sensor=sensor), bars, override)


def as_planned(scene: Scene, bars: Bars = no_bars, override: Mapping[str, Value] | None = None) -> Scene:
    """A scene as its plan has it, with items overridden, by name, that its stored plan keeps.

    A plan is made and stored if there is none, which takes seconds to minutes.

    A scene that has a plan already, or that cannot be looked at because its camera sees no surface or stands
    in one, stays as it is.

    Raises:
        UserError: the cache folder cannot be written, the stored plan contradicts the scene, or items of a
            plan that cannot be made are overridden.
    """
    if scene.plan:
        return scene
    plan = plan_for(scene, bars)
    if plan is None:
        if override:
            raise UserError(f"{scene.name}: has no plan of which {', '.join(override)} could be overridden")
        return scene
    return scene.planned({**plan.values(), **(override or {})})


def plan_for(scene: Scene, bars: Bars = no_bars) -> ScenePlan | None:
    """The stored plan of a scene; made and stored now if there is none; None if it cannot be made."""
    stored = _stored(scene)
    if stored is not None:
        return stored
    _LOG.info("No plan for scene %s yet: looking at it first.", scene.name)
    try:
        with bars(f"plan for {scene.name} (parts)") as bar:
            plan = plan_of(scene, DISPLAYS[DISPLAY], SIZE, progress=bar)
    except UserError as error:
        _LOG.warning("%s; using defaults", error)
        return None
    store_plan(plan)
    return plan


def store_plan(plan: ScenePlan) -> None:
    """Stores a plan; from now on, it is that of its scene.

    Raises:
        UserError: the cache folder cannot be written.
    """
    text = json_text({"version": _VERSION, "scene": plan.scene_hash, "decisions": plan.rows()})
    write_whole(_file(plan.scene_name, plan.scene_hash), lambda part: part.write_text(text))


def with_plan_of(scene: Scene, other: Scene) -> Scene:
    """A scene with its own plan, else with that of another version of it, which is stored as its own.

    It has none if neither has, or if something moves in one of them only. UserError if the cache folder
    cannot be written.
    """
    plan = _stored(scene)
    known = _stored(other) if plan is None and motion_of(scene) == motion_of(other) else None
    if known is not None:
        plan = replace(known, scene_name=scene.name, scene_hash=scene.own_hash)
        store_plan(plan)
    return scene if plan is None else scene.planned(plan.values())


def _file(name: str, digest: str) -> Path:
    return scene_folder(name, digest) / "plan.json"


def _stored(scene: Scene) -> ScenePlan | None:
    """The plan in the scene's folder; None if there is none, or none that this version reads.

    Raises:
        UserError: it contradicts the scene.
    """
    file = _file(scene.name, scene.own_hash)
    try:
        content = read_json(file)
        if (content["version"], content["scene"]) != (_VERSION, scene.own_hash):
            return None
        decisions = tuple(Decision(**row) for row in content["decisions"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    plan = ScenePlan(scene.name, scene.own_hash, decisions)
    require_plan(plan.values(), scene, file)
    return plan


# Least and greatest whole number that each item may be.
_NUMBERS = {
    DEPTH: (1, 1_000_000),
    ROULETTE: (1, 1_000_000),
    DEGREE: (0, MAX_DEGREE),
    LAYERS: (1, 32),
    GAUSSIANS: (1, 100_000_000),
    SAMPLES: (1, MOST_SPP),
}
_WORDS = {DENOISING: (DENOISED, RAW), FRAME_PRECISION: (HALF, SINGLE)}


def parsed(given: Sequence[str]) -> dict[str, Value]:
    """Values by name, from texts such as "degree=0".

    Raises:
        UserError: there is no such item, or it cannot have that value.
    """
    found: dict[str, Value] = {}
    for text in given:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise UserError(f"{text}: must be NAME=VALUE")
        found[name] = _value(name, value)
    return found


def _value(name: str, value: str) -> Value:
    if name in _NUMBERS:
        least, most = _NUMBERS[name]
        if not value.isascii() or not value.isdigit() or not least <= int(value[:12]) <= most:
            raise UserError(f"{name}={value}: must be a whole number from {least} to {most}")
        return int(value)
    if name in _WORDS:
        if value not in _WORDS[name]:
            raise UserError(f"{name}={value}: must be {' or '.join(_WORDS[name])}")
        return value
    names = ", ".join((*_NUMBERS, *_WORDS))
    raise UserError(f"{name}={value}: must be one of {names}; the scene decides all else")


def overridden(plan: ScenePlan, values: Mapping[str, Value]) -> ScenePlan:
    """A plan with some decisions taken by the user; those have no gain that anybody knows."""
    decisions = []
    for one in plan.decisions:
        if one.name in values:
            evidence = {"planned": one.value, **one.evidence}
            one = replace(one, value=values[one.name], evidence=evidence, gain=1.0)
        decisions.append(one)
    return replace(plan, decisions=tuple(decisions))
