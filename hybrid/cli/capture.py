"""`hybrid capture`."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hybrid.cli import options as o
from hybrid.cli.many_machines import chosen_part, on_ray, said_part
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import MOST_SPP
from pathtrace.trace import Integrator, integrator_named

if TYPE_CHECKING:
    from pathtrace.dataset.frame_set import FrameSet

_MOST_VIEWS = 100_000


def capture(
    scene: o.SceneName,
    frames: o.FramesFolder,
    views: Annotated[int, o.frame(help="Training views.", max=_MOST_VIEWS)] = 64,
    held_out: Annotated[
        int, o.measurement(help="Held-out views, to which nothing is fitted.", max=_MOST_VIEWS)
    ] = 8,
    size: o.FixedSize = (256, 256),
    fov: Annotated[
        float | None,
        o.frame(help="Horizontal field of view in degrees. Default: vertically, that of the scene's camera."),
    ] = None,
    spp: Annotated[
        int | None,
        o.frame(
            help="Samples per pixel of a training view. Default: as planned for the scene.",
            min=1,
            max=MOST_SPP,
        ),
    ] = None,
    held_out_spp: Annotated[
        int, o.measurement(help="Samples per pixel of a held-out view.", max=MOST_SPP)
    ] = 256,
    integrator: Annotated[
        str,
        o.frame(help="Integrator of training views: path, or cached (faster). Held-out views are unbiased."),
    ] = Integrator.CACHED.value,
    monocular: Annotated[
        bool,
        o.frame(
            "--monocular", help="A single camera that sways around the scene's own over time, as in a video."
        ),
    ] = False,
    max_depth: o.MaxDepth = None,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    override: o.Override = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
    part: o.PartName = None,
    ray: o.RayAddress = None,
) -> o.Measured:
    """Render training frames; resumes if interrupted."""
    if ray is not None:
        return on_ray(ray, part, frames)
    mine = chosen_part(part)
    o.select(backend)
    from hybrid.base.cache_folder import keep_receipt
    from hybrid.preparation.capture_parts import CaptureJob, capture_part
    from hybrid.preparation.decisions import FIXED_SAMPLES, SAMPLES
    from hybrid.render.irradiance import cache_for
    from pathtrace.dataset.capture import capture as run
    from pathtrace.dataset.frame_set import CaptureSettings
    from pathtrace.scene.scene import load_scene

    with o.user_errors():
        settings = CaptureSettings(
            views, held_out, *size, spp or FIXED_SAMPLES, held_out_spp, seed, monocular, fov
        )
    o.require_size(size)
    traced = integrator_named(integrator)
    start = time.perf_counter()
    if mine is not None:
        job = CaptureJob(settings, spp, traced, o.overridden(override))
        loaded = load_scene(scene, max_depth, thin_glass, sensor=sensor)
        stored = capture_part(loaded, frames, mine, job, progress_bar)
        said_part(stored)
        return {"scene": loaded.name, "part": part, "seconds": time.perf_counter() - start}
    loaded = o.planned_scene(scene, max_depth, thin_glass, sensor, override)
    settings = replace(settings, spp=spp or loaded.plan.get(SAMPLES, FIXED_SAMPLES))
    cache = cache_for(loaded, progress_bar) if traced is Integrator.CACHED else None
    with progress_bar("capture (samples)") as bar:
        found = run(loaded, Path(frames), settings, bar, cache)
    keep_receipt(found)
    seconds = time.perf_counter() - start
    print_views(found)
    return {
        "scene": found.scene_name,
        "views": len(found.training),
        "held_out": len(found.held_out),
        "width": size[0],
        "height": size[1],
        "spp": settings.spp,
        "integrator": found.integrator,
        "seconds": seconds,
    }


def print_views(frames: FrameSet) -> None:
    """Says what a frame set has."""
    counts = f"{len(frames.training)} training views and {len(frames.held_out)} held-out views"
    print(f"{counts} in {frames.folder}")
