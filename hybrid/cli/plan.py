"""`hybrid plan`."""

from __future__ import annotations

from typing import Any

from hybrid.cli.options import (
    Backend,
    DisplayName,
    FixedSize,
    Json,
    MaxDepth,
    SceneName,
    Seed,
    ThinGlass,
    loaded_scene,
    select,
    write_json,
)
from hybrid.runtime.progress import progress_bar


def plan(
    scene: SceneName,
    size: FixedSize = (1920, 1080),
    display: DisplayName = "desktop",
    max_depth: MaxDepth = None,
    thin_glass: ThinGlass = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Look at a scene for a few seconds, and say what it requires of the renderers, and why."""
    select(backend)
    from compose.eye.display import display_named
    from hybrid.plan.plan import plan_of
    from hybrid.runtime.machine import machine

    shown = display_named(display)
    loaded = loaded_scene(scene, max_depth, thin_glass)
    with progress_bar("plan (parts)") as bar:
        found = plan_of(loaded, shown, size, seed, bar)
    for row in found.rows():
        print(
            f"{row['name']:<16}{row['value']!s:<10}(else {row['fixed']!s}; {row['of']} / {row['gain']:.2f})"
        )
        print(f"{'':<16}{_shown(row['evidence'])}")
    write_json(
        json_file, {"scene": loaded.name, "size": size, "decisions": found.rows(), "machine": machine()}
    )


def _shown(evidence: dict[str, Any]) -> str:
    """Numbers behind a decision in one line; lists are left to the JSON file."""
    parts = []
    for name, value in evidence.items():
        if isinstance(value, float):
            parts.append(f"{name.replace('_', ' ')} {value:.3g}")
        elif not isinstance(value, list | dict) or not value:
            parts.append(f"{name.replace('_', ' ')} {value if value else 0}")
        elif isinstance(value, dict):
            parts.append(", ".join(f"{key} {_plain(of)}" for key, of in value.items()))
    return ", ".join(parts)


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)
