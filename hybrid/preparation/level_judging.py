"""Learns what quality continuous levels of detail have, from pictures that FovVideoVDP judges."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera, turned
from compose.camera.coordinate_systems import WORLD
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from hybrid.measure.perceptual_metrics import difference_map, jod
from hybrid.render.frame_settings import BEST_JOD, FrameSettings
from hybrid.render.level_quality import LevelQuality
from hybrid.render.periphery import Periphery
from splat.model.forest import Forest
from splat.training.picture_fit import CutViews, visibility_of_nodes

# Where visible differences are judged that are shared among nodes, in degrees from the gaze.
_ECCENTRICITY = 10.0
# Views whose quality is judged, and the Gaussians that are drawn, as parts of those that each shows.
_VIEWS, _SHARES = 8, (0.75, 0.6, 0.45, 0.35, 0.25)
# Standard deviations, in degrees by which those are turned, and of gazes in parts of the frame.
_TURN, _GAZE = 10.0, 0.2
# Qualities in JOD that the law is fitted to: others are hardly asked for.
_WORST, _FINEST = 8.0, 9.97
# Of laws where nothing can be seen, and of all.
_USUAL_EXPONENT, _LEAST_EXPONENT = 0.45, 0.1


@dataclass(frozen=True)
class Judged:
    """What was visible per pixel in a view, and the quality that it was given."""

    view: int
    visible: float
    jod: float


def judged_quality(
    views: CutViews,
    forest: Forest,
    display: Display,
    seed: int,
    steps: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[LevelQuality, float]:
    """The quality of a forest's levels, and the mean error in JOD in views that it was not fitted to.

    Args:
        views: from which the hierarchy was fitted, which the forest has.
        display: on which pictures are judged; FovVideoVDP is installed.
        steps: cuts whose visible differences are shared among nodes.
        progress: is told of steps done, and all.
    """
    hierarchy, judged = forest.own_hierarchy, _VIEWS * len(_SHARES)
    rng = np.random.default_rng([seed, 4])

    def difference(picture: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
        shown, expected = (image.clamp(0, 1).cpu().numpy() for image in (picture, truth))
        return difference_map(shown, expected, display, _ECCENTRICITY).to(picture.device)

    visibility = visibility_of_nodes(
        views, hierarchy, seed, steps, difference, lambda done, _: progress(done, steps + judged)
    )
    unfitted = LevelQuality(visibility, 1.0, 1.0, display)
    rows = []
    for row in _judged(views.arrays, replace(forest, place=WORLD), views.cameras, unfitted, rng):
        rows.append(row)
        progress(steps + len(rows), steps + judged)
    scale, exponent = _law(rows)
    errors = []
    for view in range(_VIEWS):
        own = LevelQuality(visibility, *_law([row for row in rows if row.view != view]), display)
        errors += [abs(own.jod(row.visible) - row.jod) for row in rows if row.view == view and _counts(row)]
    return LevelQuality(visibility, scale, exponent, display), float(np.mean(errors)) if errors else 0.0


def _judged(
    arrays: Arrays,
    forest: Forest,
    cameras: Sequence[Camera],
    quality: LevelQuality,
    rng: np.random.Generator,
) -> Iterator[Judged]:
    """Cuts in views around cameras, in the coordinates of the forest's nodes."""
    periphery, display = Periphery(arrays, forest), quality.display
    for view in range(_VIEWS):
        pose = cameras[int(rng.integers(len(cameras)))].camera_to_world
        pose[:3, :3] = turned(pose[:3, :3], *(_TURN * rng.normal(size=2)))
        camera = display.viewer(display.width, display.height).at(pose)
        gaze = Gaze(*np.clip(0.5 + _GAZE * rng.normal(size=2), 0, 1).tolist())
        settings = FrameSettings(gaze, fov_a=0.0, fov_b=0.0, display=display)
        region = settings.foveation.region(camera.width, camera.height)
        whole = periphery.whole(camera, settings)
        for share in _SHARES:
            few = replace(settings, gaussians=max(1, round(share * whole.nodes)))
            detail = periphery.detail(camera, few)
            image, truth = periphery.draw(camera, detail, region).numpy(), whole.numpy()
            given = jod(image, truth, display, gaze)
            assert detail.levels is not None, "levels are continuous"
            visible = float(periphery.visible(camera, detail, detail.levels, quality)[0])
            yield Judged(view, visible, BEST_JOD if given is None else given)


def _counts(row: Judged) -> bool:
    return _WORST <= row.jod <= _FINEST


def _law(rows: list[Judged]) -> tuple[float, float]:
    """Scale and exponent, by least squares of logarithms; a scale of 0 if nothing can be seen."""
    seen = [row for row in rows if row.jod < BEST_JOD and row.visible > 0]
    some = [row for row in seen if _counts(row)] or seen
    if not some:
        return 0.0, _USUAL_EXPONENT
    visible, lost = (
        np.log(values) for values in zip(*((row.visible, BEST_JOD - row.jod) for row in some), strict=True)
    )
    spread = visible - visible.mean()
    exponent = float(spread @ lost / max(spread @ spread, 1e-12))
    exponent = min(max(exponent, _LEAST_EXPONENT), 1.0)
    return float(np.exp(np.mean(lost) - exponent * np.mean(visible))), exponent
