"""`hybrid scenes`: lists the bundled scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hybrid.cli import options as o


def scenes(backend: o.Backend = "auto", json_file: o.Json = None) -> None:
    """List the bundled scenes and their facts."""
    o.select(backend)
    from pathtrace.scene.scene import bundled_scenes

    rows = [_facts(name, file) for name, file in bundled_scenes().items()]
    for row in rows:
        nodes = " + ".join(f"{count:,}" for count in row["nodes_per_layer"])
        forest = f"forest {row['forest']}: {row['trees']:,} trees, layers of {nodes} nodes"
        print(
            f"{row['scene']}: {row['triangles']:,} triangles, {row['emitters']} emitters, "
            f"depth {row['max_depth']}, {row['width']} x {row['height']}, "
            + (forest if row["forest"] else "no forest yet")
        )
    o.write_json(json_file, rows)


def _facts(name: str, file: Path) -> dict[str, Any]:
    from hybrid.base.cache_folder import newest_forest
    from hybrid.preparation.scene_plan import scene_as_stored
    from splat.io.forest_file import load_forest

    scene = scene_as_stored(name)
    forest = newest_forest(scene)
    counts = load_forest(forest).counts if forest else ()
    return {
        "scene": name,
        "triangles": scene.triangles,
        "emitters": len(scene.mitsuba.emitters()),
        "max_depth": scene.max_depth,
        "width": scene.camera.width,
        "height": scene.camera.height,
        "file": str(file),
        "forest": str(forest) if forest else None,
        "nodes_per_layer": list(counts),
        "trees": counts[0] if counts else 0,
    }
