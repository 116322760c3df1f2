"""The plan of a scene in the cache folder, and scenes as planned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from compose.base.files import write_whole
from compose.base.json_file import read_json
from compose.eye.display import DISPLAYS
from hybrid.plan.decision import Decision
from hybrid.plan.paths import DEPTH, ROULETTE
from hybrid.plan.plan import ScenePlan, plan_of
from hybrid.plan.values import require_plan
from hybrid.runtime.progress import Bars, console, no_bars
from hybrid.runtime.valid_json import json_text
from hybrid.store.cache import scene_folder
from pathtrace.scene.scene import Scene, load_scene

_VERSION = 2
# Of frames where nothing else is asked for.
DISPLAY, SIZE = "desktop", (1920, 1080)


def planned_scene(
    source: str | Path | dict[str, Any],
    max_depth: int | None = None,
    thin_glass: bool = False,
    bars: Bars = no_bars,
) -> Scene:
    """Loads a scene with the paths that are planned for it.

    Args:
        source, max_depth, thin_glass: as of `load_scene`; a depth that is given stays.
        bars: show the progress of planning.

    Raises:
        UserError: as of `load_scene`, or the cache folder cannot be written.
    """
    scene = load_scene(source, max_depth, thin_glass)
    return _as_planned(scene, plan_for(scene, bars), max_depth)


def scene_as_stored(source: str) -> Scene:
    """Loads a scene as its stored plan has it; as its file has it if there is none."""
    scene = load_scene(source)
    return _as_planned(scene, _stored(scene))


def _as_planned(scene: Scene, plan: ScenePlan | None, max_depth: int | None = None) -> Scene:
    if plan is None:
        return scene
    scene = scene if max_depth is not None else scene.at_depth(plan.value(DEPTH))
    values = {**plan.values(), DEPTH: scene.max_depth}
    return replace(scene, roulette_depth=plan.value(ROULETTE), plan=values)


def plan_for(scene: Scene, bars: Bars = no_bars) -> ScenePlan | None:
    """The stored plan of a scene; if there is none, it is made in seconds and stored.

    None of a scene that cannot be looked at, because its camera sees no surface or stands in one.

    Raises:
        UserError: the cache folder cannot be written, or the stored plan contradicts the scene.
    """
    stored = _stored(scene)
    if stored is not None:
        require_plan(stored.values(), scene, _file(scene.name, scene.own_hash))
        return stored
    try:
        with bars(f"plan for {scene.name} (parts)") as bar:
            plan = plan_of(scene, DISPLAYS[DISPLAY], SIZE, progress=bar)
    except UserError as error:
        console.print(f"{error}; what it requires is not planned", soft_wrap=True)
        return None
    store_plan(plan)
    return plan


def store_plan(plan: ScenePlan) -> None:
    """Stores a plan; from now on, it is that of its scene.

    Raises:
        UserError: the cache folder cannot be written.
    """
    content = {"version": _VERSION, "scene": plan.scene_hash, "decisions": plan.rows()}
    text = json_text(content)
    write_whole(_file(plan.scene_name, plan.scene_hash), lambda part: part.write_text(text))


def _file(name: str, digest: str) -> Path:
    return scene_folder(name, digest) / "plan.json"


def _stored(scene: Scene) -> ScenePlan | None:
    """The plan in the scene's folder; None if there is none, or none that this version reads."""
    try:
        content = read_json(_file(scene.name, scene.own_hash))
        if (content["version"], content["scene"]) != (_VERSION, scene.own_hash):
            return None
        return ScenePlan(scene.name, scene.own_hash, tuple(Decision(**row) for row in content["decisions"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
