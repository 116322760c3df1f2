"""`hybrid levels`: continuous levels of detail of a forest, fitted to look as its finest layer does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from compose.base.errors import UserError
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar

_STEPS = 2000
# Focal length in pixels of the views of Gaussians that were trained on frames of no known size.
_FOCAL = 300.0


def levels(
    source: o.ForestArgument,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Forest file to write. Default: the same."),
    ] = None,
    steps: Annotated[
        int, typer.Option(help="Steps of the fit, each of one view.", min=1, max=o.MOST_FRAMES)
    ] = _STEPS,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
    json_file: o.Json = None,
) -> None:
    """Fit the levels of detail that `render --level` and `--gaussians` draw; takes a minute or two.

    Gaussians of the finest layer are joined to a tree, and its inner nodes are fitted to pictures of that
    layer, so no paths are traced. Until it is finished, the file stays as it is.
    """
    from splat.io.forest_file import load_forest, save_forest

    target = source if output is None else output
    o.check_writable(target)
    forest = load_forest(source)
    if forest.motion is not None or forest.light is not None:
        raise UserError(f"{source}: something moves in it, which has no continuous levels of detail")
    o.select(backend)
    from hybrid.base.compute_device import device_arrays
    from hybrid.render.forest_attachments import own_views
    from splat.io.ply import UNBOUND_FOCAL
    from splat.model.hierarchy import hierarchy_of
    from splat.training.display_fit import views_around
    from splat.training.hierarchy_fit import fitted_hierarchy

    finest, focal = forest.layers[-1], forest.trained_focal
    if focal == UNBOUND_FOCAL:
        focal = _FOCAL
    views = own_views(forest) or views_around(finest.gaussians, focal, seed)
    with progress_bar("tree (Gaussians)") as bar:
        hierarchy = hierarchy_of(finest, bar)
    with progress_bar("fit of levels (steps)") as bar:
        fitted = fitted_hierarchy(
            device_arrays(), hierarchy, finest.gaussians, focal, views, seed, steps, bar
        )
    hierarchy, first, last = fitted
    save_forest(target, replace(forest, hierarchy=hierarchy))
    facts = {"gaussians": len(finest), "inner": len(hierarchy), "psnr_before": first, "psnr": last}
    print(f"{target}: {len(hierarchy):,} inner nodes over {len(finest):,} Gaussians")
    print(f"cuts are {last:.1f} dB from pictures of the finest layer ({first:.1f} before)")
    o.write_json(json_file, facts)
