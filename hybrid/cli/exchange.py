"""`hybrid export` and `hybrid import`: files of 3D Gaussian splatting, glTF scenes, data sets of COLMAP."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from compose.base.errors import UserError
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from splat.model.choices import Precision

if TYPE_CHECKING:
    from pathtrace.gltf.document import Document
    from splat.model.forest import Forest
    from splat.model.gaussians import Gaussians


def export_file(
    source: Annotated[
        Path, typer.Argument(metavar="FOREST|FRAMES", help="Forest file, or folder of a frame set.")
    ],
    output: Annotated[
        Path,
        typer.Argument(
            metavar="FILE|FOLDER",
            help=".ply to write, or .glb, .splat, .ksplat, .spz or .sog; FOLDER/lod-meta.json for all levels "
            "of detail (Streamed SOG); of frames, a new folder.",
        ),
    ],
    layer: Annotated[
        int | None,
        typer.Option(help="Layer to write, from 1, the coarsest. Default: the finest.", show_default=False),
    ] = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> None:
    """Write one layer of a forest as a file that other viewers of 3D Gaussian splatting open.

    Gaussians that were trained here are fitted to look there as they do here; imported ones are written as
    they came. Or write the frames of a frame set as a data set of COLMAP, on which other programs train.
    """
    if source.is_dir():
        if layer is not None:
            raise UserError(f"--layer: only of a forest; {source} is a folder of frames")
        from pathtrace.dataset.colmap_layout import write_colmap
        from pathtrace.dataset.frame_set import read_frame_set

        images, points = write_colmap(read_frame_set(source), output)
        print(f"{output}: {images:,} images, {points:,} points")
        return
    from splat.io.forest_file import load_forest
    from splat.io.other_formats import INDEX, format_of, save_gaussians
    from splat.model.gaussians import Blending
    from splat.model.points import in_world

    if output.name == INDEX:
        if layer is not None:
            raise UserError(f"--layer: {INDEX} holds all levels of detail")
        _export_streamed(load_forest(source), output, seed, backend)
        return
    format_of(output)
    loaded = load_forest(source)
    layers = loaded.layers
    number = len(layers) if layer is None else layer
    if not 1 <= number <= len(layers):
        raise UserError(f"--layer {layer}: {source} has layers 1 to {len(layers)}")
    gaussians, said = layers[number - 1].gaussians, "as imported"
    if gaussians.blending is Blending.LINEAR:
        o.select(backend)
        gaussians, psnr = _fitted(loaded, number, seed)
        said = f"{psnr:.1f} dB from the forest's own pictures"
    save_gaussians(output, in_world(gaussians, loaded.place))
    print(f"{output}: layer {number}, {len(gaussians):,} Gaussians, degree {gaussians.degree}, {said}")


# Levels of detail of a forest of one layer, each of so many times fewer Gaussians than the one before.
_LEVELS, _RATIO = 4, 4


def _export_streamed(forest: Forest, output: Path, seed: int, backend: str) -> None:
    """Writes a forest as Streamed SOG: its layers, or levels of detail that its hierarchy makes of one."""
    from splat.io.other_formats import save_streamed
    from splat.model.gaussians import Blending
    from splat.model.points import in_world

    o.check_writable(output)
    levels = [layer.gaussians for layer in reversed(forest.layers)]
    if levels[0].blending is Blending.LINEAR:
        o.select(backend)
        levels = [_fitted(forest, number, seed)[0] for number in range(len(levels), 0, -1)]
    if len(levels) == 1:
        levels = forest.own_hierarchy.nodes(levels[0]).levels(_LEVELS, _RATIO)
    with progress_bar("chunks (Gaussians)") as bar:
        chunks = save_streamed(output.parent, [in_world(level, forest.place) for level in levels], bar)
    counts = ", ".join(f"{len(level):,}" for level in levels)
    print(f"{output}: levels of {counts} Gaussians in {chunks} chunks")


def _fitted(forest: Forest, layer: int, seed: int) -> tuple[Gaussians, float]:
    """Gaussians of a layer for other viewers, and how they look there, as `fitted_for_display` returns it."""
    from hybrid.base.compute_device import device_arrays
    from hybrid.render.forest_attachments import own_views
    from splat.training.picture_fit import fitted_for_display, views_around

    gaussians, focal = forest.layers[layer - 1].gaussians, forest.focal_of(layer)
    views = own_views(forest) or views_around(gaussians, focal, seed)
    with progress_bar("fit for other viewers (steps)") as bar:
        return fitted_for_display(device_arrays(), gaussians, focal, views, seed, bar)


def import_file(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="File of 3D Gaussian splatting (.ply, .splat, .ksplat, .spz, .sog, .glb, .gltf), or scene "
            "in .glb or .gltf.",
        ),
    ],
    target: Annotated[
        Path, typer.Argument(metavar="FOREST|FOLDER", help="Forest file to write; for glTF, a new folder.")
    ],
    fps: Annotated[
        float | None,
        typer.Option(
            help="For glTF: meshes per second of deforming objects. Default: 24.",
            min=0.1,
            max=240,
            callback=o.finite,
        ),
    ] = None,
    animation: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="For glTF: the animation to play, by name or number. Default: all, if they move different "
            "things, else the first.",
        ),
    ] = None,
    precision: o.NumberPrecision = Precision.COMPACT,
) -> None:
    """Read a file of 3D Gaussian splatting as a forest, or a glTF file as a scene that moves.

    A glTF file without triangles that has Gaussians (KHR_gaussian_splatting) becomes a forest.
    """
    gaussians = None
    if source.suffix.lower() in (".glb", ".gltf"):
        from pathtrace.gltf.document import read_document

        document = read_document(source)
        gaussians = _of_gltf(document)
        if gaussians is None:
            _import_scene(document, target, fps, animation)
            return
    if fps is not None or animation is not None:
        raise UserError(f"--fps, --animation: only of scenes in .glb and .gltf files; {source} is none")
    from splat.io.compact import compact
    from splat.io.forest_file import save_forest
    from splat.io.other_formats import load_gaussians
    from splat.io.ply import UNBOUND_FOCAL
    from splat.model.forest import forest_of
    from splat.model.hierarchy import hierarchy_of
    from splat.model.points import from_world, place_of_gaussians
    from splat.model.trees import static_layer

    gaussians = load_gaussians(source) if gaussians is None else gaussians
    place = place_of_gaussians(gaussians)
    layer = static_layer(from_world(gaussians, place))
    # Without a hash of a scene: it fits any.
    imported = forest_of([layer], UNBOUND_FOCAL, source.stem, "", place)
    with progress_bar("levels of detail (Gaussians)") as bar:
        hierarchy = hierarchy_of(imported.layers[-1], bar)
    imported = replace(imported, hierarchy=hierarchy)
    save_forest(target, imported if precision is Precision.FLOAT32 else compact(imported))
    print(f"{target}: {len(gaussians):,} Gaussians, degree {gaussians.degree}")


def _of_gltf(document: Document) -> Gaussians | None:
    """The Gaussians of a glTF document; None of one that shows triangles, or none."""
    from pathtrace.gltf.gaussians import read_gaussians
    from splat.io.gltf_gaussians import gaussians_from
    from splat.model.gaussians import concatenated

    remarks: list[str] = []
    parts = read_gaussians(document, remarks)
    try:
        found = [gaussians_from(**vars(part)) for part in parts]
    except ValueError as error:
        raise document.refused(str(error)) from error
    for remark in remarks:
        print(remark)
    return concatenated(found) if found else None


def _import_scene(document: Document, target: Path, fps: float | None, animation: str | None) -> None:
    o.select("auto")
    from pathtrace.gltf.importing import DEFAULT_FPS, import_gltf

    with o.option_names("animation", "fps"):
        found = import_gltf(document, target, fps or DEFAULT_FPS, animation)
    moving = f"{found.rigid} move rigidly, {found.deforming} deform, in {found.seconds:g} s"
    print(f"{found.scene}: {found.triangles:,} triangles; {moving if found.seconds else 'nothing moves'}")
    for remark in found.remarks:
        print(remark)
