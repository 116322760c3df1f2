"""How well the two renderers meet: how much they differ in the band, and whether that is visible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.eye.gaze import Gaze
from compose.fovea.mode import FoveaMode
from compose.fovea.region import FoveaRegion
from compose.image.colour import Image, luminance
from hybrid.bench.metrics import means
from hybrid.bench.views import unfitted_views
from hybrid.frame.frame import Frame
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.measure.metrics.fovvideovdp import jod
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.measure.regions import Region, plain_regions
from pathtrace.dataset.frames import FrameSet
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest

GAZES = (Gaze(0.5, 0.5), Gaze(0.35, 0.4))
_SCALE = 2
# Sectors around the band: wide enough to average noise, narrow enough to show local differences.
_SECTORS = 24
# Differences are not taken relative to a luminance below this.
_DARK = 0.01


def bench_seam(
    scene: Scene,
    frames: FrameSet,
    forest: Forest,
    settings: FrameSettings,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per fovea mode: means over gazes and the unfitted views, at twice their resolution.

    Args:
        scene, forest: what is rendered.
        frames: that the forest was trained on.
        settings: of the frames, apart from camera, gaze and mode.
        reference_spp: samples per pixel of the references.
        progress: called with views done and views in total.

    Returns:
        Rows with `difference`, how much brighter the fovea is than the splats, over the band, relative to the
        reference; `sectors`, the root mean square of that over sectors of the band; and, if installed, the
        band's `jod`.
    """
    found: dict[FoveaMode, list[dict[str, float]]] = {mode: [] for mode in FoveaMode}
    views = unfitted_views(frames)
    renderer = Renderer(scene, forest)
    for done, view in enumerate(views):
        camera = view.resized(view.width * _SCALE, view.height * _SCALE)
        truth = reference(renderer.tracer, camera, reference_spp, REFERENCE_SEED).radiance
        for gaze, mode in product(GAZES, FoveaMode):
            at_gaze = replace(settings, camera=camera, gaze=gaze, fovea=mode)
            band = plain_regions(at_gaze.foveation, (camera.height, camera.width), ("seam",))["seam"]
            found[mode].append(_seam(renderer.frame(at_gaze, done), band, truth))
        progress(done + 1, len(views))
    return [
        {"scene": scene.name, "mode": mode.value, "spp": settings.spp, **means(rows)}
        for mode, rows in found.items()
    ]


def _seam(frame: Frame, band: Region, truth: Image) -> dict[str, float]:
    """One frame's part of a row; only traced pixels of the band count."""
    region, disc = frame.region, np.asarray(frame.fovea.disc.pixels)
    pixels = disc[band.mask.ravel()[disc]]
    right = luminance(truth.reshape(-1, 3)[pixels])
    outer = luminance(frame.periphery.reshape(-1, 3)[pixels])
    inner = luminance(frame.of_disc(frame.fovea.radiance).reshape(-1, 3)[pixels])
    difference = inner - outer
    sector = _sectors(region, pixels)
    present = np.unique(sector)
    local = [difference[sector == s].mean() / max(right[sector == s].mean(), _DARK) for s in present]
    row = {
        "difference": float(difference.mean() / max(right.mean(), _DARK)),
        "sectors": float(np.sqrt(np.mean(np.square(local)))),
    }
    seen = jod(band.alone(frame.composite, truth), truth, frame.settings.display, frame.settings.gaze)
    return row if seen is None else {**row, "jod": seen}


def _sectors(region: FoveaRegion, pixels: NDArray[np.uint32]) -> NDArray[np.int64]:
    """(B,) number of the sector that each of B pixels lies in."""
    row, column = pixels // region.width, pixels % region.width
    angle = np.arctan2(row + 0.5 - region.centre[1], column + 0.5 - region.centre[0])
    return ((angle / (2 * np.pi) + 0.5) * _SECTORS).astype(np.int64) % _SECTORS
