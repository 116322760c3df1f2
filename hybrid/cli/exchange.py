"""`hybrid export` and `hybrid import`: the PLY layout of 3D Gaussian splatting."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from compose.base.errors import UserError
from hybrid.cli.options import ForestArgument


def export_ply(
    forest: ForestArgument,
    output: Annotated[Path, typer.Argument(metavar="out.ply", help="PLY file to write.")],
    layer: Annotated[
        int | None, typer.Option(help="1, the coarsest, to L; L if left out.", show_default=False)
    ] = None,
) -> None:
    """Write one layer of a forest as a PLY file that other viewers of 3D Gaussian splatting open."""
    from splat.io.forest_file import load_forest
    from splat.io.ply import save_ply
    from splat.model.placing import in_world

    loaded = load_forest(forest)
    layers = loaded.layers
    number = len(layers) if layer is None else layer
    if not 1 <= number <= len(layers):
        raise UserError(f"--layer {layer}: {forest} has layers 1 to {len(layers)}")
    gaussians = in_world(layers[number - 1].gaussians, loaded.place)
    save_ply(output, gaussians)
    print(f"{output}: layer {number}, {len(gaussians):,} Gaussians, degree {gaussians.degree}")


def import_ply(
    source: Annotated[Path, typer.Argument(metavar="in.ply", help="PLY file to read.")],
    forest: ForestArgument,
) -> None:
    """Read a PLY file of 3D Gaussian splatting; the forest fits any scene."""
    from splat.io.forest_file import save_forest
    from splat.io.ply import UNBOUND_FOCAL, load_ply
    from splat.model.forest import forest_of
    from splat.model.layer import static_layer
    from splat.model.placing import from_world, place_of_gaussians

    gaussians = load_ply(source)
    place = place_of_gaussians(gaussians)
    layer = static_layer(from_world(gaussians, place))
    save_forest(forest, forest_of([layer], UNBOUND_FOCAL, source.stem, "", place))
    print(f"{forest}: {len(gaussians):,} Gaussians, degree {gaussians.degree}")
