"""What a scene requires: the plan that follows from a look at it for a few seconds.

It is stored in the cache folder and is part of frame sets and forests. A picture shows what it follows from.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from compose.base.errors import UserError
from compose.base.files import json_text, read_json, write_whole
from compose.base.traced_samples import DIFFUSE
from compose.eye.display import DISPLAYS, Display
from compose.image.colour import Image, srgb_from_radiance
from hybrid.base.cache_folder import scene_folder
from hybrid.base.progress import Bar, Bars, no_bars, no_progress
from hybrid.preparation.decisions import (
    GAUSSIANS,
    Decision,
    Value,
    breadth_of,
    degree_decision,
    frame_precision_decision,
    gaussians_decision,
    layers_decision,
    path_decisions,
    region_decision,
    sample_decisions,
)
from hybrid.preparation.scene_look import VIEWS, Look, look_at_scene
from pathtrace.region import NEAR, region_of
from pathtrace.scene.optics import light_difficulties
from pathtrace.scene.scene import DEPTH, Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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

    Frames of `size`, width and height in pixels, are shown on the display; viewers are in the region
    (pathtrace.region). Same seed, same plan on the same machine. `progress` is called with parts done, their
    number, and what comes next. UserError if the scene's own camera sees no surface, there is no such region,
    or no free space in it.
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
    """UserError, which names the source, if something moves in a scene planned as still, or the reverse."""
    fact = motion_of(scene)
    if (planned := values.get(MOTION, fact)) != fact:
        raise UserError(f"{source}: its plan has {MOTION} {planned}, but {scene.name} has {fact}")


_FILE, _VERSION = "plan.json", 4
# Of frames where nothing else is asked for.
DISPLAY, SIZE = "desktop", (1920, 1080)


def as_stored(scene: Scene) -> Scene:
    """A scene as its stored plan has it if there is one, but with a depth that it was given.

    UserError if the plan contradicts the scene.
    """
    plan = _stored(scene)
    return scene if plan is None else scene.planned(plan.values())


def as_planned(scene: Scene, bars: Bars = no_bars, override: Mapping[str, Value] | None = None) -> Scene:
    """A scene as its plan has it, with items overridden, by name, that its stored plan keeps.

    A plan is made and stored if there is none, which takes seconds to minutes. A scene that has a plan
    already, or that cannot be looked at because its camera sees no surface or stands in one, stays as it is.

    UserError if the cache folder cannot be written, the stored plan contradicts the scene, or items of a plan
    that cannot be made are overridden.
    """
    if scene.plan:
        return scene
    plan = plan_for(scene, bars)
    if plan is None and override:
        raise UserError(f"{scene.name}: has no plan of which {', '.join(override)} could be overridden")
    return scene if plan is None else scene.planned({**plan.values(), **(override or {})})


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
    """Stores a plan; from now on, it is that of its scene. UserError if the folder cannot be written."""
    text = json_text({"version": _VERSION, "scene": plan.scene_hash, "decisions": plan.rows()})
    write_whole(scene_folder(plan.scene_name, plan.scene_hash) / _FILE, lambda part: part.write_text(text))


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


def _stored(scene: Scene) -> ScenePlan | None:
    """The plan in the scene's folder; None if there is none, or none that this version reads."""
    file = scene_folder(scene.name, scene.own_hash) / _FILE
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


def overridden(plan: ScenePlan, values: Mapping[str, Value]) -> ScenePlan:
    """A plan with some decisions taken by the user; those have no gain that anybody knows."""
    decisions = [
        replace(one, value=values[one.name], evidence={"planned": one.value, **one.evidence}, gain=1.0)
        if one.name in values
        else one
        for one in plan.decisions
    ]
    return replace(plan, decisions=tuple(decisions))


_TURNING = (0.9, 0.2, 0.1)
_SHARE = 0.7


def write_picture(path: Path, plan: ScenePlan, look: Look) -> None:
    """Writes a PNG: what the scene looks like, where its radiance turns, what Gaussians bring, its depths."""
    # Not pyplot, which opens windows and has global state.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7), layout="constrained")
    grid = figure.add_gridspec(2, 3)
    shown, turning, numbers = (figure.add_subplot(grid[0, column]) for column in range(3))
    depths, decisions = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1:])
    frame = srgb_from_radiance(look.denoised[0])
    _image(shown, frame, f"{plan.scene_name}, one of {len(look.views)} views")
    view = srgb_from_radiance(look.radiance[0])
    turns = ((look.gloss[0] != DIFFUSE) | look.reflected[0])[..., None]
    marked = np.where(turns, (1 - _SHARE) * view + _SHARE * np.array(_TURNING), view)
    _image(turning, marked, "radiance turns with the view (red)")
    # What numbers of Gaussians leave, each in one colour, and the number that is planned.
    decision = plan.decision(GAUSSIANS)
    curve = decision.evidence["error_db"]
    numbers.semilogx([int(count) for count in curve], list(curve.values()), "o-", color="#36c")
    numbers.axvline(float(decision.value), color="#c33")
    numbers.set_xlabel("Gaussians", fontsize=8)
    numbers.set_title("dB of as many plain ones; planned (red)", fontsize=9)
    _plot_depths(depths, plan)
    rows = [(row["name"], str(row["value"]), str(row["fixed"])) for row in plan.rows()]
    decisions.axis("off")
    table = decisions.table(rows, colLabels=("", "planned", "else"), loc="center", cellLoc="left")
    table.scale(1.3, 1.4)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_whole(path, lambda part: part.write_bytes(buffer.getvalue()))


def _image(axes: Axes, image: Image, title: str) -> None:
    axes.imshow(np.clip(image, 0, 1), interpolation="nearest")
    axes.set_title(title, fontsize=9)
    axes.axis("off")


def _plot_depths(axes: Axes, plan: ScenePlan) -> None:
    """Share of the radiance by the segments of paths, and where they are cut, if that was measured."""
    evidence = plan.decision(DEPTH).evidence
    if "needed" not in evidence:
        axes.axis("off")
        return
    depth, shares = evidence["needed"], evidence["share_by_depth"]
    axes.bar(range(1, len(shares) + 1), np.maximum(shares, 1e-6), color="#36c")
    axes.axvline(depth + 0.5, color="#c33")
    axes.set_yscale("log")
    axes.set_xlabel("segments", fontsize=8)
    axes.set_title(f"share of radiance; {evidence['beyond']:.2%} lies beyond {depth}", fontsize=9)
