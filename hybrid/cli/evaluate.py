"""`hybrid evaluate`: quality and speed of hybrid frames against baselines."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid.cli.options import (
    INPUT,
    MEASUREMENT,
    MOST_FRAMES,
    MOST_REFERENCE_SPP,
    Backend,
    DisplayName,
    FixedSize,
    ForestFile,
    FovA,
    FovB,
    Gaze,
    IntegratorName,
    Json,
    SceneName,
    Seed,
    Spp,
    ThinGlass,
    fill_irradiance,
    loaded_scene,
    require_size,
    select,
    write_json,
)
from hybrid.cli.progress import progress_bar
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.render.frame_settings import EVALUATION, FrameSettings

_DEFAULTS = EvaluationSettings()


def evaluate(
    scene: SceneName,
    report: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for the page, its images, and what it resumes from.")
    ],
    forest: ForestFile = None,
    baseline_forest: Annotated[
        Path | None,
        typer.Option(
            metavar="FOREST",
            help="Gaussians without trees to compare with (train --layers 1).",
            rich_help_panel=INPUT,
        ),
    ] = None,
    size: FixedSize = (_DEFAULTS.width, _DEFAULTS.height),
    views: Annotated[
        int, typer.Option(help="Views to measure.", min=1, max=1000, rich_help_panel=MEASUREMENT)
    ] = _DEFAULTS.views,
    gaze: Gaze = None,
    fov_a: FovA = EVALUATION.fov_a,
    fov_b: FovB = EVALUATION.fov_b,
    spp: Spp = EVALUATION.spp,
    integrator: IntegratorName = None,
    reference_spp: Annotated[
        int,
        typer.Option(
            help="Samples per pixel of the references; eight times as many in the disc.",
            min=4,
            max=MOST_REFERENCE_SPP,
            rich_help_panel=MEASUREMENT,
        ),
    ] = _DEFAULTS.reference_spp,
    repeats: Annotated[
        int,
        typer.Option(
            help="Timed frames per method; fewer of those that would take over 80 s.",
            min=3,
            max=MOST_FRAMES,
            rich_help_panel=MEASUREMENT,
        ),
    ] = _DEFAULTS.repeats,
    display: DisplayName = "desktop",
    thin_glass: ThinGlass = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Compare hybrid frames with baselines at equal rays and at equal time; resumes if interrupted."""
    from hybrid.render.image_files import check_writable

    frame = FrameSettings(gaze or EVALUATION.gaze, fov_a, fov_b, spp, display=display, integrator=integrator)
    settings = EvaluationSettings(frame, *size, views, reference_spp, repeats, seed)
    require_size(size)
    settings.require_measurable()
    check_writable(report / "index.html")
    select(backend)
    from hybrid.api.evaluation_report import evaluate as run
    from hybrid.base.identity import require_scene
    from hybrid.evaluation.results import verdicts
    from hybrid.measure.frame_quality import missing
    from hybrid.preparation.preparation import with_forest
    from hybrid.render.forest_attachments import scene_as_trained
    from splat.io.forest_file import load_forest

    loaded = loaded_scene(scene, None, thin_glass)
    if baseline_forest is not None:
        # Refused before any bar appears, and before a forest is trained.
        flat = load_forest(baseline_forest)
        require_scene(flat, loaded.name, scene_as_trained(loaded, flat).hash, baseline_forest)
    # Training shows bars of its own.
    loaded, trained = with_forest(loaded, forest, progress_bar)
    fill_irradiance(loaded, frame)
    with progress_bar("evaluate") as bar:
        found = run(
            loaded,
            trained,
            report,
            settings,
            baseline_forest=baseline_forest,
            progress=lambda done, total, what: bar(int(1000 * done / total), 1000, what),
        )
    write_json(json_file, found)
    for line in (*missing(), *verdicts(found), report / "index.html"):
        print(line)
    _print(found)


def _print(found: dict[str, Any]) -> None:
    """Foveal and whole quality of each method, mean over the views, beside its time."""
    from hybrid.evaluation.result_keys import HALVES_KEY
    from hybrid.evaluation.results import budget_label, keys_of, mean_of

    times = {(row["method"], row["budget"]): row["ms"]["p50"] for row in found["time"]}
    keys = [HALVES_KEY, *keys_of(found)]
    means = {
        (region, metric): [mean_of(found, key, region, metric) for key in keys]
        for region in ("foveal", "whole")
        for metric in ("psnr", "ssim", "flip", "jod")
    }
    columns = {key: values for key, values in means.items() if None not in values}
    head = "".join(f"{region[:3] + ' ' + metric:>10}" for region, metric in columns)
    labels = [budget_label(found, key) for key in keys]
    width = max(12, 2 + max(map(len, labels)))
    print(f"{'method':<34}{'budget':<{width}}{'ms':>6}{head}")
    for number, key in enumerate(keys):
        cells = "".join(f"{values[number]:>10.4g}" for values in columns.values())
        print(f"{key[0]:<34}{labels[number]:<{width}}{round(times[key]) if key in times else '-':>6}{cells}")
