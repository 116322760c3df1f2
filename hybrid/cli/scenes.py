"""`hybrid scenes`: lists the bundled scenes, or says how one is seen here."""

from __future__ import annotations

import logging
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from compose.base.errors import UserError
from hybrid.cli import options as o

if TYPE_CHECKING:
    from pathtrace.scene.scene import Scene


def scenes(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="[SCENE]",
            help="Name of a bundled scene, or a Mitsuba XML file: to say what of it is left out, and compare "
            "its picture with that of Mitsuba's own integrator. Default: list the bundled scenes.",
            show_default=False,
        ),
    ] = None,
    sensor: o.Sensor = None,
    backend: o.Backend = "auto",
) -> o.Measured:
    """List the bundled scenes and their facts, or examine one scene."""
    o.select(backend)
    from pathtrace.scene.scene import bundled_scenes

    if scene is not None:
        # What is left out is among the results.
        logging.getLogger("hybrid").setLevel(logging.WARNING)
        loaded = o.loaded_scene(scene, sensor=sensor)
        row = _facts(loaded, scene)
        _print_facts(row)
        return row | {"parity": _compare(loaded, scene, sensor)}
    rows = [_facts(o.loaded_scene(name), str(file)) for name, file in bundled_scenes().items()]
    for row in rows:
        _print_facts(row)
    return rows


def _compare(scene: Scene, source: str, sensor: str | None) -> dict[str, Any] | None:
    """Says whether a scene looks as Mitsuba renders it, and why not; the facts of that, if it renders it."""
    from pathtrace.trace.parity import parity

    for line in scene.left_out:
        print(line)
    try:
        found = parity(scene, source, sensor)
    except UserError as error:
        print(f"not compared: {error}")
        return None
    radiance = f"mean radiance {found.theirs:.4g} there, {found.ours:.4g} here"
    if found.holds:
        print(f"as {found.by} renders it: {radiance}; no part of {found.parts} differs by more than noise")
    else:
        print(f"not as {found.by} renders it: {radiance}; {found.differing} of {found.parts} parts differ")
        unknown = "what is left out may be why" if scene.left_out else "the cause is not known"
        for cause in found.causes or (unknown,):
            print(f"  {cause}")
    return asdict(found)


def _print_facts(row: dict[str, Any]) -> None:
    nodes = " + ".join(f"{count:,}" for count in row["nodes_per_layer"])
    form = "{scene}: {triangles:,} triangles, {emitters} emitters, depth {max_depth}, {width} x {height}, "
    form += "forest {forest}: {trees:,} trees, layers of {nodes} nodes" if row["forest"] else "no forest yet"
    print(form.format(**row, nodes=nodes))


def _facts(scene: Scene, file: str) -> dict[str, Any]:
    from hybrid.base.cache_folder import newest_forest
    from splat.io.forest_file import load_forest

    forest = newest_forest(scene)
    counts = load_forest(forest).counts if forest else ()
    return {
        "scene": scene.name,
        "triangles": scene.triangles,
        "emitters": len(scene.mitsuba.emitters()),
        "max_depth": scene.max_depth,
        "left_out": scene.left_out,
        "width": scene.camera.width,
        "height": scene.camera.height,
        "file": file,
        "forest": str(forest) if forest else None,
        "nodes_per_layer": list(counts),
        "trees": counts[0] if counts else 0,
    }
