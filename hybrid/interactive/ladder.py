"""What frames of the window take and are worth, from coarse to fine: measured once, then remembered."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace

import numpy as np
from PIL import Image as Pillow

from compose.base.errors import UserError
from compose.base.files import write_whole
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.interactive.request import Request, Shows
from hybrid.interactive.source import FrameSource, Shown
from hybrid.measure.metrics.fovvideovdp import jod
from hybrid.measure.metrics.ssim import ssim
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.measure.timing import gaze_path
from hybrid.plan.controller import Rung
from hybrid.plan.pareto import pareto_front
from hybrid.runtime.progress import Report
from hybrid.store.cache import scene_folder
from hybrid.store.identity import short_hash

_REFERENCE_SPP = 16
# Frames whose time is taken, and those before them.
_TIMED, _WARM_UP = 5, 2
_RADII = (5.0, 8.0, 11.0, 15.0, 20.0, 25.0, 30.0)


def ladder_for(source: FrameSource, like: Request, report: Report) -> list[Rung]:
    """The settings worth choosing among, each slower and better than the one before it.

    Args:
        source: of frames.
        like: a request with the window's size and acuity model.
        report: called with what is done, how many steps of it, and of how many.
    """
    scene, camera = source.renderer.tracer.scene, source.camera.resized(like.camera.width, like.camera.height)
    size = f"{camera.width}x{camera.height}"
    forest = source.renderer.periphery.forest.digest()
    seen_by = short_hash({"forest": forest, "display": asdict(source.display)})
    file = scene_folder(scene.name, scene.hash) / f"window-{size}-{like.settings.acuity_model}-{seen_by}.json"
    if file.is_file():
        try:
            return frontier([Rung(**row) for row in json.loads(file.read_text())])
        except (OSError, ValueError, TypeError) as error:
            raise UserError(f"{file}: is damaged ({error!r}); remove it, and it is measured again") from error
    measured = _measured(source, replace(like, camera=camera), report)
    text = json.dumps([asdict(rung) for rung in measured], indent=1) + "\n"
    write_whole(file, lambda part: part.write_text(text))
    return frontier(measured)


def frontier(rungs: list[Rung]) -> list[Rung]:
    """Those of which none is both quicker and better, from the quickest to the slowest."""
    return pareto_front(rungs, lambda rung: (rung.milliseconds, rung.quality))


def candidates(layers: int) -> list[Rung]:
    """Settings from very coarse to very fine, for a forest of so many layers."""
    coarse = [Rung(radius, 1, layers, 0, scale) for scale in (0.5, 0.75) for radius in (8.0, 15.0)]
    coarse += [Rung(radius, 1, layers, 1, 1.0) for radius in (8.0, 15.0)]
    coarse += [Rung(8.0, 1, max(layers - 1, 1), 0, 1.0)]
    fine = [Rung(radius, 1, layers, 0, 1.0) for radius in _RADII]
    fine += [Rung(radius, spp, layers, 0, 1.0) for spp in (2, 4) for radius in (15.0, 20.0, 30.0)]
    return list(dict.fromkeys(coarse + fine))


def _measured(source: FrameSource, like: Request, report: Report) -> list[Rung]:
    wanted = candidates(len(source.renderer.periphery.forest.counts))
    what = "what frames take and are worth"
    report(what, 0, len(wanted) + 1)
    truth = reference(source.renderer.tracer, like.camera, _REFERENCE_SPP, REFERENCE_SEED).radiance
    rungs = []
    for number, rung in enumerate(wanted):
        report(what, number + 1, len(wanted) + 1)
        request = replace(like, settings=rung.applied(like.settings), shows=Shows.COMPOSITE)
        rungs.append(_of(source, request, rung, truth))
    report(what, len(wanted) + 1, len(wanted) + 1)
    source.forget()
    return rungs


def _of(source: FrameSource, request: Request, rung: Rung, truth: Image) -> Rung:
    """The rung with its time and its quality at first sight, without any history."""
    times = []
    for gaze in gaze_path(_WARM_UP + _TIMED):
        start = time.perf_counter()
        source.show(replace(request, gaze=gaze), False)
        times.append((time.perf_counter() - start) * 1000)
    source.forget()
    shown = source.show(replace(request, gaze=Gaze()), False)
    milliseconds = float(np.median(times[_WARM_UP:]))
    return replace(rung, milliseconds=milliseconds, quality=_quality(source, shown, request.camera, truth))


def _quality(source: FrameSource, shown: Shown, camera: Camera, truth: Image) -> float:
    """JOD to a viewer who looks at the middle; SSIM where that is not installed."""
    composite = _enlarged(shown.frame.composite, camera)
    found = jod(composite, truth, source.display, Gaze())
    return ssim(composite, truth) if found is None else found


def _enlarged(image: Image, camera: Camera) -> Image:
    """(H, W, 3) at the window's resolution, as it is shown there."""
    size = camera.width, camera.height
    if image.shape[1::-1] == size:
        return image
    planes = [
        Pillow.fromarray(plane).resize(size, Pillow.Resampling.BILINEAR) for plane in np.moveaxis(image, 2, 0)
    ]
    return np.stack([np.asarray(plane) for plane in planes], axis=2)
