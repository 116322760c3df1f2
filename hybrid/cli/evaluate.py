"""`hybrid evaluate`: quality and speed of hybrid frames against baselines."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.render.frame_settings import EVALUATION, FrameSettings

_DEFAULTS = EvaluationSettings()


def evaluate(
    scene: o.SceneName,
    report: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for the page, its images and intermediate results.")
    ],
    forest: o.ForestFile = None,
    baseline_forest: Annotated[
        Path | None,
        o.inputs(
            metavar="FOREST", help="Forest of Gaussians without trees, as a baseline (train --layers 1)."
        ),
    ] = None,
    size: o.FixedSize = (_DEFAULTS.width, _DEFAULTS.height),
    views: Annotated[int, o.measurement(help="Views to measure.", min=1, max=1000)] = _DEFAULTS.views,
    gaze: o.Gaze = None,
    fov_a: o.FovA = EVALUATION.fov_a,
    fov_b: o.FovB = EVALUATION.fov_b,
    spp: o.Spp = EVALUATION.spp,
    integrator: o.IntegratorName = None,
    reference_spp: Annotated[
        int,
        o.measurement(
            help="Samples per pixel of the references; eight times as many in the disc.",
            min=4,
            max=o.MOST_REFERENCE_SPP,
        ),
    ] = _DEFAULTS.reference_spp,
    repeats: Annotated[
        int,
        o.measurement(
            help="Timed frames per method; fewer if they would take over 80 s.", min=3, max=o.MOST_FRAMES
        ),
    ] = _DEFAULTS.repeats,
    display: o.DisplayName = "desktop",
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Compare hybrid frames with baselines at equal rays and at equal time; resumes if interrupted."""
    frame = FrameSettings(gaze or EVALUATION.gaze, fov_a, fov_b, spp, display=display, integrator=integrator)
    settings = EvaluationSettings(frame, *size, views, reference_spp, repeats, seed)
    o.require_size(size)
    settings.require_measurable()
    o.check_writable(report / "index.html")
    o.select(backend)
    from hybrid.api.workflow import evaluate as run
    from hybrid.base.identity import require_scene
    from hybrid.evaluation.results import HALVES_KEY, Results, verdicts
    from hybrid.measure.frame_quality import missing
    from hybrid.preparation.preparation import with_forest
    from hybrid.render.forest_attachments import scene_as_trained
    from splat.io.forest_file import load_forest

    loaded = o.loaded_scene(scene, None, thin_glass, sensor)
    if baseline_forest is not None:
        # Refused before any bar appears, and before a forest is trained.
        flat = load_forest(baseline_forest)
        require_scene(flat, loaded.name, scene_as_trained(loaded, flat).hash, baseline_forest)
    # Training shows bars of its own.
    loaded, trained = with_forest(loaded, forest, progress_bar)
    o.fill_irradiance(loaded, frame)
    with progress_bar("evaluate") as bar:
        found = run(
            loaded,
            trained,
            report,
            settings,
            baseline_forest=baseline_forest,
            progress=lambda done, total, what: bar(int(1000 * done / total), 1000, what),
        )
    for line in (*missing(), *verdicts(found), report / "index.html"):
        print(line)
    # Foveal and whole quality of each method, mean over the views, beside its time.
    results = Results(found)
    keys = [HALVES_KEY, *results.keys]
    means = {
        f"{region[:3]} {metric}": [results.mean(key, region, metric) for key in keys]
        for region in ("foveal", "whole")
        for metric in ("psnr", "ssim", "flip", "jod")
    }
    columns = {name: values for name, values in means.items() if None not in values}
    labels = [results.budget_label(key) for key in keys]
    width = max(12, 2 + max(map(len, labels)))
    print(f"{'method':<34}{'budget':<{width}}{'ms':>6}" + "".join(f"{name:>10}" for name in columns))
    for key, label, *values in zip(keys, labels, *columns.values(), strict=True):
        milliseconds = round(results.times[key]) if key in results.times else "-"
        cells = "".join(f"{value:>10.4g}" for value in values)
        print(f"{key.method:<34}{label:<{width}}{milliseconds:>6}{cells}")
    return found
