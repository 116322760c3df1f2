"""`hybrid evaluate`: how good, how fast, and what else could be had for that."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid.cli.options import (
    Backend,
    DisplayName,
    ForestFile,
    FovA,
    FovB,
    GazeAt,
    Json,
    SceneName,
    Seed,
    Spp,
    checked,
    loaded_scene,
    select,
    write_json,
)
from hybrid.runtime.progress import progress_bar


def evaluate(
    scene: SceneName,
    report: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder for the page, its pictures and what is needed to go on."),
    ],
    forest: ForestFile = None,
    peer_forest: Annotated[
        Path | None,
        typer.Option(metavar="FOREST", help="Gaussians without trees to compare with: train --layers 1."),
    ] = None,
    size: Annotated[tuple[int, int], typer.Option(metavar="W H", help="Frame size.")] = (512, 512),
    views: Annotated[int, typer.Option(help="Views to measure.", min=1)] = 5,
    gaze: GazeAt = (0.5, 0.5),
    fov_a: FovA = 20.0,
    fov_b: FovB = 15.0,
    spp: Spp = 1,
    reference_spp: Annotated[
        int, typer.Option(help="Samples per pixel of the references; eight times as many in the disc.", min=4)
    ] = 32,
    repeats: Annotated[
        int, typer.Option(help="Frames timed per method; fewer of those that would take over 80 s.", min=3)
    ] = 300,
    display: DisplayName = "desktop",
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Compare hybrid frames with what else could be had at equal rays and time; goes on if interrupted."""
    from compose.eye.display import display_named
    from hybrid.evaluate.settings import EvaluationSettings
    from hybrid.output.images import check_writable

    settings = checked(
        EvaluationSettings,
        width=size[0],
        height=size[1],
        views=views,
        gaze_x=gaze[0],
        gaze_y=gaze[1],
        fov_a=fov_a,
        fov_b=fov_b,
        spp=spp,
        reference_spp=reference_spp,
        repeats=repeats,
        seed=seed,
    )
    shown = display_named(display)
    check_writable(report / "index.html")
    select(backend)
    from hybrid.evaluate.evaluation import Evaluation
    from hybrid.evaluate.verdicts import verdicts
    from hybrid.measure.metrics.installed import missing
    from hybrid.report.evaluation_page import write_report
    from hybrid.store.identity import require_scene
    from hybrid.training.quick import forest_for
    from splat.io.forest_file import load_forest

    loaded = loaded_scene(scene)
    flat = None
    if peer_forest is not None:
        flat = load_forest(peer_forest)
        require_scene(flat, loaded.name, loaded.hash, peer_forest)
    evaluation = Evaluation(loaded, forest_for(loaded, forest), shown, settings, report, flat)
    with progress_bar("evaluate") as bar:
        found = evaluation.run(lambda what, done, total: bar(int(1000 * done / total), 1000, what))
    write_json(report / "evaluation.json", found)
    write_report(report)
    write_json(json_file, found)
    for line in missing():
        print(line)
    for line in verdicts(found):
        print(line)
    print(report / "index.html")
    _print(found)


def _print(found: dict[str, Any]) -> None:
    """Foveal and whole quality of each method, mean over the views, beside its time."""
    from hybrid.evaluate.judged import HALVES
    from hybrid.evaluate.verdicts import keys_of, mean_of

    times = {(row["method"], row["budget"]): row["ms"]["p50"] for row in found["time"]}
    keys = [(HALVES, "fixed"), *keys_of(found)]
    means = {
        (region, metric): [mean_of(found, key, region, metric) for key in keys]
        for region in ("foveal", "whole")
        for metric in ("psnr", "ssim", "flip", "jod")
    }
    columns = {key: values for key, values in means.items() if None not in values}
    head = "".join(f"{region[:3] + ' ' + metric:>10}" for region, metric in columns)
    print(f"{'method':<34}{'budget':<12}{'ms':>6}{head}")
    for number, key in enumerate(keys):
        cells = "".join(f"{values[number]:>10.4g}" for values in columns.values())
        print(f"{key[0]:<34}{key[1]:<12}{round(times[key]) if key in times else '-':>6}{cells}")
