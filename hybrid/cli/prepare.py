"""`hybrid plan`, `hybrid prepare` and `hybrid quickstart`: from a scene to a forest, and to first frames."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from compose.base.errors import UserError
from hybrid.cli import options as o
from hybrid.cli.many_machines import chosen_part, on_ray, said_part
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import DEFAULTS, FrameSettings


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
) -> o.Measured:
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
    return {"scene": loaded.name, "size": size, "decisions": found.rows(), "machine": machine()}


def _shown(evidence: dict[str, Any]) -> str:
    """Numbers behind a decision in one line; lists are left to the JSON file."""
    parts = []
    for name, value in evidence.items():
        if isinstance(value, dict) and value:
            parts.append(", ".join(f"{key} {_plain(of)}" for key, of in value.items()))
        elif not isinstance(value, list) or not value:
            parts.append(f"{name.replace('_', ' ')} {_plain(value or 0)}")
    return ", ".join(parts)


def _plain(value: object) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def prepare(
    scene: o.SceneName,
    forest: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Also write the forest here.")
    ] = None,
    quality: Annotated[str, typer.Option(help="glimpse, draft, standard, high or live.")] = "standard",
    minutes: Annotated[
        float | None, typer.Option(help="Time budget in minutes; overrides --quality.")
    ] = None,
    psnr: Annotated[
        float | None, typer.Option(help="PSNR in dB to reach on held-out views; overrides --quality.")
    ] = None,
    region: o.RegionName = None,
    held_out: Annotated[
        int, o.measurement(help="Held-out validation views; their time is not counted.", max=10_000)
    ] = 4,
    size: o.FixedSize = (256, 256),
    max_depth: o.MaxDepth = None,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    override: o.Override = None,
    clamp_indirect: Annotated[
        float | None,
        o.inputs(
            help="Upper limit on the indirect radiance added to a path of a training frame at once: fewer "
            "fireflies, darker caustics."
        ),
    ] = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
    part: o.PartName = None,
    ray: o.RayAddress = None,
    shared: o.SharedFolder = None,
) -> o.Measured:
    """Capture and train in turns, from nothing to a forest; resumes if interrupted.

    Of N parts with --part, each traces a share of the frames, with as many views and samples as --quality
    has in all, and `hybrid merge` trains the forest on them.
    """
    started = time.perf_counter()
    from hybrid.preparation.stages import PreparationSettings

    with o.option_names("quality", "minutes", "psnr", "held_out", most_indirect="clamp-indirect"):
        settings = PreparationSettings(
            region or "near", quality, minutes, psnr, held_out, size, clamp_indirect, seed
        )
    o.require_size(size)
    o.require_both(part, shared)
    if shared is not None and forest is not None:
        raise UserError("--output: has no influence on parts, whose forest is in --shared; leave it out")
    if ray is not None:
        return on_ray(ray, part, shared)
    mine = chosen_part(part)
    o.select(backend)
    if mine is not None and shared is not None:
        from hybrid.preparation.capture_parts import capture_part, preparation_job
        from pathtrace.scene.scene import load_scene

        with o.option_names("part", "region", "size", most_indirect="clamp-indirect"):
            job = preparation_job(settings, o.overridden(override))
        parted = load_scene(scene, max_depth, thin_glass, sensor=sensor)
        said_part(capture_part(parted, shared, mine, job, progress_bar))
        return {"scene": parted.name, "part": part, "seconds": time.perf_counter() - started}
    from hybrid.preparation.decisions import REGION
    from hybrid.preparation.preparation import prepare as run

    o.check_writable(forest)
    loaded = o.planned_scene(scene, max_depth, thin_glass, sensor, override)
    settings = replace(settings, region=region or str(loaded.plan.get(REGION, settings.region)))
    facts = run(loaded, settings, progress_bar, started=started).facts
    if forest is not None:
        shutil.copyfile(facts["forest"], forest)
        facts = {**facts, "forest": str(forest)}
    limit = "" if facts["limit"] is None else f"; limited by {facts['limit']}"
    print(
        f"{facts['gaussians']:,} Gaussians from {facts['views']} views, whose frames have "
        f"{facts['frame_error_db']:.1f} dB, in {facts['seconds']:.0f} s{limit}"
    )
    return facts


def quickstart(
    scene: Annotated[str, typer.Argument(metavar="[SCENE]")] = "room",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for images, page and numbers.")] = Path(
        "out"
    ),
    fov_a: o.FovA = DEFAULTS.fov_a,
    fov_b: o.FovB = DEFAULTS.fov_b,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    override: o.Override = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Capture, train, render and measure: the main job, from nothing to images and numbers."""
    settings = FrameSettings(fov_a=fov_a, fov_b=fov_b)
    o.select(backend)
    from hybrid.evaluation.quickstart import SIZE
    from hybrid.evaluation.quickstart import quickstart as run

    if not settings.foveation.region(SIZE, SIZE).count:
        raise UserError(f"--fov-a {fov_a}: there is no fovea to show, it holds no pixel of {SIZE} x {SIZE}")
    o.check_writable(out / "result.json")
    result = run(
        o.planned_scene(scene, None, thin_glass, sensor, override), out, settings, seed, progress_bar
    )
    o.write_json(out / "result.json", result)
    print(
        f"hybrid {result['hybrid']['psnr']:.2f} dB, splats {result['splats_alone']['psnr']:.2f} dB, "
        f"{result['ratio']:.2f} x faster than full path tracing, {result['seconds']['total']:.0f} s in total"
    )
    print(f"Open {out / 'index.html'}")
    return result
