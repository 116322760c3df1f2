"""`hybrid evaluate`: quality and speed of hybrid frames against baselines."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid.cli import options as o
from hybrid.cli.many_machines import chosen_part, on_ray, said_part
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
    apart: Annotated[
        int, o.measurement(help="Views beyond the prepared region, and wider ones, each.", min=0, max=1000)
    ] = _DEFAULTS.apart,
    seeds: Annotated[
        int, o.measurement(help="Frames per method and view, of independent noise.", min=1, max=1000)
    ] = _DEFAULTS.seeds,
    reference_spp: Annotated[
        int,
        o.measurement(
            help="Samples per pixel of the references; twice as many in the disc.",
            min=4,
            max=o.MOST_REFERENCE_SPP,
        ),
    ] = _DEFAULTS.reference_spp,
    raw_references: Annotated[
        bool, o.measurement("--raw-references", help="Do not denoise the references.")
    ] = False,
    repeats: Annotated[
        int,
        o.measurement(help="Timed frames per method and view; 3 at least.", min=3, max=o.MOST_FRAMES),
    ] = _DEFAULTS.repeats,
    quick: Annotated[
        bool,
        o.measurement(
            "--quick",
            help="Only baselines at equal time, in views near the scene's own; as many samples and views.",
        ),
    ] = False,
    display: o.DisplayName = "desktop",
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
    part: o.PartName = None,
    ray: o.RayAddress = None,
) -> o.Measured:
    """Compare hybrid frames with baselines at equal rays and at equal time; resumes if interrupted.

    Says at the end what each baseline is ahead of, equal to or behind, with intervals over the views.
    """
    frame = FrameSettings(gaze or EVALUATION.gaze, fov_a, fov_b, spp, display=display, integrator=integrator)
    settings = EvaluationSettings(
        frame, *size, views, apart, seeds, reference_spp, not raw_references, repeats, quick, seed
    )
    o.require_size(size)
    settings.require_measurable()
    if ray is not None:
        return on_ray(ray, part, report, is_timed=True)
    mine = chosen_part(part)
    o.check_writable(report / "index.html")
    o.select(backend)
    from hybrid.api.workflow import evaluate as run
    from hybrid.base.identity import require_scene
    from hybrid.base.parts import first_come
    from hybrid.evaluation.evaluation import evaluation_of
    from hybrid.preparation.preparation import with_forest
    from hybrid.render.forest_attachments import scene_as_trained
    from splat.io.forest_file import load_forest

    loaded = o.loaded_scene(scene, None, thin_glass, sensor)
    if baseline_forest is not None:
        # Refused before any bar appears, and before a forest is trained.
        flat = load_forest(baseline_forest)
        require_scene(flat, loaded.name, scene_as_trained(loaded, flat).hash, baseline_forest)
    # Training shows bars of its own; what is not there yet is made by one part.
    with nullcontext() if mine is None else first_come(report):
        loaded, trained = with_forest(loaded, forest, progress_bar)
        o.fill_irradiance(loaded, frame)
    with progress_bar("evaluate" if mine is None else f"evaluate, {mine}") as bar:
        if mine is None:
            found = run(
                loaded,
                trained,
                report,
                settings,
                baseline_forest=baseline_forest,
                progress=bar,
            )
            print_evaluation(report, found)
            return found
        evaluation = evaluation_of(loaded, trained, settings, report, baseline_forest, mine)
        found = evaluation.run(lambda what, done, total: bar(int(1000 * done), 1000 * int(total), what))
    assert evaluation.part is not None
    said_part(evaluation.part)
    return found


def print_evaluation(report: Path, found: dict[str, Any]) -> None:
    """Prints what an evaluation says, and foveal and whole quality of each method beside its time."""
    from hybrid.evaluation.results import Results
    from hybrid.evaluation.verdicts import sentences
    from hybrid.measure.frame_quality import missing

    for line in (*missing(), *sentences(found), report / "index.html"):
        print(line)
    results = Results(found)
    means = {
        f"{region[:3]} {metric}": [results.mean(key, region, metric) for key in results.keys]
        for region in ("foveal", "whole")
        for metric in ("psnr", "ssim", "flip", "jod")
    }
    columns = {name: values for name, values in means.items() if None not in values}
    labels = [results.budget_label(key) for key in results.keys]
    width = max(12, 2 + max(map(len, labels)))
    print(f"{'method':<44}{'budget':<{width}}{'ms':>6}" + "".join(f"{name:>10}" for name in columns))
    for key, label, *values in zip(results.keys, labels, *columns.values(), strict=True):
        milliseconds = round(results.times[key]) if key in results.times else "-"
        cells = "".join(f"{value:>10.4g}" for value in values)
        print(f"{key.method:<44}{label:<{width}}{milliseconds:>6}{cells}")
