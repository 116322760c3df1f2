"""`hybrid train`, on frame sets or third-party posed images, and `hybrid levels`, of what was trained."""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from compose.base.errors import UserError
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from splat.model.choices import Labels, MotionModel, Precision


def train(
    frames: o.FramesFolder,
    forest: Annotated[Path, typer.Argument(metavar="FOREST", help="Forest file to write.")],
    iterations: Annotated[int, typer.Option(help="Optimizer steps over all layers.", max=10_000_000)] = 3000,
    gaussians: Annotated[
        int | None,
        typer.Option(
            help="Final number of Gaussians in the finest layer. Default: as planned, else 40,000.",
            max=o.MOST_GAUSSIANS,
        ),
    ] = None,
    layers: Annotated[
        int | None,
        typer.Option(
            help="Layers of the forest; 1 for Gaussians without trees. Default: as planned, else 4."
        ),
    ] = None,
    degree: Annotated[
        int | None,
        typer.Option(help="Degree of the spherical harmonics, 0 to 3. Default: as planned, else 2."),
    ] = None,
    motion: Annotated[
        MotionModel | None,
        typer.Option(
            help="Motion model: known trajectories from the frame set, or a learned deformation field, that "
            "of D-GS (for everything, or only for what the frames show to move) or of 4DGS. Default: known; "
            "for third-party images of several times, 4dgs."
        ),
    ] = None,
    labels: Annotated[
        Labels | None,
        typer.Option(
            help="How d-gs-dynamic knows which pixels move: by exact masks in the frame set, or by the flow "
            "between frames of different times. Default: masks where there are any.",
            show_default=False,
        ),
    ] = None,
    precision: o.NumberPrecision = Precision.COMPACT,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Train a forest on a frame set; resumes if interrupted.

    Also on third-party posed images, without a scene: folders in the layout of NeRF-synthetic, D-NeRF,
    nerfstudio, instant-ngp, COLMAP, Nerfies, HyperNeRF or NeRF-DS.
    """
    o.select(backend)
    from hybrid.base.cache_folder import has_receipt, store_forest
    from hybrid.preparation.forest_errors import held_out_quality
    from hybrid.preparation.forest_training import LeftOut, planned_settings, say_left_out
    from hybrid.preparation.forest_training import train as run
    from hybrid.preparation.training_views import motion_for, read_frames
    from pathtrace.dataset.posed_images import PosedFolder

    shape = {"gaussians": gaussians, "layers": layers, "degree": degree}
    given = {"iterations": iterations, "seed": seed, **shape}
    with o.user_errors():
        # What is given is checked before the frames are read.
        planned_settings(None, **given)
    found = read_frames(frames)
    with o.user_errors(), o.option_names("motion", "labels"):
        settings = planned_settings(found, **given, motion=motion_for(found, motion, labels), labels=labels)
    o.check_writable(forest)
    if isinstance(found, PosedFolder):
        field = f"a learned field deforms the Gaussians ({settings.motion.value})"
        print(
            f"{found.folder}: {len(found.training)} frames to train on and {len(found.held_out)} held out, "
            f"layout of {found.layout}; {'nothing moves' if settings.motion.field is None else field}"
        )
    start = time.perf_counter()
    left_out: list[LeftOut] = []
    with progress_bar("train (steps)") as bar:
        trained = run(found, forest, settings, bar, left_out.append, precision=precision)
    seconds = time.perf_counter() - start
    say_left_out(left_out[0])
    # The hash of third-party images is that of the very images that were trained on here.
    if not isinstance(found, PosedFolder) and settings.motion.field is not None:
        print(
            f"the motion was learned, for comparison with that of the scene: the forest does not become the "
            f"newest one of {found.scene_name}; name it by --forest"
        )
    elif isinstance(found, PosedFolder) or has_receipt(found):
        store_forest(trained, forest.stem)
    else:
        print(
            f"{frames} was not captured with this cache folder: the forest does not become the newest one of "
            f"{found.scene_name}; name it by --forest"
        )
    rows = held_out_quality(found, trained)
    facts = {"scene": found.scene_name, "layers": rows, "trees": trained.counts[0]}
    facts["left_out"] = asdict(left_out[0])
    facts["splat"] = {name: rows[-1][name] for name in ("psnr", "ssim") if name in rows[-1]}
    print(f"{sum(trained.counts):,} nodes in {trained.counts[0]:,} trees in {seconds:.0f} s")
    for row in rows:
        quality = f", held-out views {row['psnr']:.2f} dB, SSIM {row['ssim']:.4f}" if "psnr" in row else ""
        print(f"layer {row['layer']}: {row['nodes']:,} nodes{quality}")
    return {**facts, "iterations": iterations, "seconds": seconds}


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
    display: o.DisplayName = "desktop",
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Fit the levels of detail that `render --level` and `--gaussians` draw; takes a few minutes.

    Gaussians of the finest layer are joined to a tree, and its inner nodes are fitted to pictures of that
    layer, so no paths are traced. With FovVideoVDP, their quality is learnt as well, for `--level-jod` on a
    display. Until it is finished, the file stays as it is.
    """
    from compose.eye.display import display_named
    from splat.io.forest_file import load_forest, save_forest

    target, shown = source if output is None else output, display_named(display)
    o.check_writable(target)
    forest = load_forest(source)
    if forest.motion is not None or forest.light is not None:
        raise UserError(f"{source}: something moves in it, which has no continuous levels of detail")
    o.select(backend)
    from hybrid.base.compute_device import device_arrays
    from hybrid.measure.perceptual_metrics import INSTALL, has_fovvideovdp
    from hybrid.preparation.level_judging import judged_quality
    from hybrid.render.forest_attachments import own_views
    from hybrid.render.level_quality import attach_quality
    from splat.io.ply import UNBOUND_FOCAL
    from splat.model.hierarchy import hierarchy_of
    from splat.training.picture_fit import CutViews, fitted_hierarchy, views_around

    finest, focal = forest.layers[-1], forest.trained_focal
    if focal == UNBOUND_FOCAL:
        focal = _FOCAL
    views = own_views(forest) or views_around(finest.gaussians, focal, seed)
    with progress_bar("tree (Gaussians)") as bar:
        hierarchy = hierarchy_of(finest, bar)
    with progress_bar("fit of levels (steps)") as bar:
        cuts = CutViews(device_arrays(), finest.gaussians, focal, views)
        fitted = fitted_hierarchy(cuts, hierarchy, seed, steps, bar)
    hierarchy, first, last = fitted
    forest, error = attach_quality(replace(forest, hierarchy=hierarchy), None), None
    if has_fovvideovdp():
        with progress_bar("quality of levels (pictures)") as bar:
            quality, error = judged_quality(cuts, forest, shown, seed, -(-steps // 2), bar)
        forest = attach_quality(forest, quality)
    save_forest(target, forest)
    print(f"{target}: {len(hierarchy):,} inner nodes over {len(finest):,} Gaussians")
    print(f"cuts are {last:.1f} dB from pictures of the finest layer ({first:.1f} before)")
    if error is None:
        print(f"their quality is not known: {INSTALL}")
    else:
        print(f"their quality is known to {error:.2f} JOD, in views that it was not learnt from")
    found = {"psnr_before": first, "psnr": last, "jod_error": error}
    return {"gaussians": len(finest), "inner": len(hierarchy), **found}
