"""`hybrid plan`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar


def plan(
    scene: o.SceneName,
    region: o.RegionName = None,
    size: o.FixedSize = (1920, 1080),
    display: o.DisplayName = "desktop",
    override: o.Override = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write a PNG of what the plan is based on.")
    ] = None,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
    json_file: o.Json = None,
) -> None:
    """Analyse a scene for a few seconds, and decide what it requires of the renderers, and why.

    All commands take the newest plan of a scene as their default; those that capture or prepare make it
    if there is none.
    """
    o.select(backend)
    from compose.eye.display import display_named
    from hybrid.base.identity import machine
    from hybrid.preparation.scene_plan import overridden, plan_of, store_plan, write_picture
    from pathtrace.scene.scene import load_scene

    shown = display_named(display)
    wanted = o.overridden(override)
    o.check_writable(picture)
    loaded = load_scene(scene, None, thin_glass, sensor=sensor)
    with progress_bar("plan (parts)") as bar:
        found = plan_of(loaded, shown, size, region or "near", seed, bar)
    found = overridden(found, wanted)
    store_plan(found)
    assert found.look is not None
    for row in found.rows():
        print(
            f"{row['name']:<16}{row['value']!s:<10}(else {row['fixed']!s}; {row['of']} / {row['gain']:.2f})"
        )
        print(f"{'':<16}{_shown(row['evidence'])}")
    if picture is not None:
        write_picture(picture, found, found.look)
    o.write_json(
        json_file, {"scene": loaded.name, "size": size, "decisions": found.rows(), "machine": machine()}
    )


def _shown(evidence: dict[str, Any]) -> str:
    """Numbers behind a decision in one line; lists are left to the JSON file."""
    parts = []
    for name, value in evidence.items():
        if isinstance(value, dict) and value:
            parts.append(", ".join(f"{key} {_plain(of)}" for key, of in value.items()))
        elif not isinstance(value, list) or not value:
            parts.append(f"{name.replace('_', ' ')} {_plain(value or 0)}")
    return ", ".join(parts)


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)
