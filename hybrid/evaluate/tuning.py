"""What a peer is set to is chosen on views that are not measured: nobody shall be beaten at a bad setting."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import product

import numpy as np

from compose.blend import Image
from compose.view import Camera, Gaze
from hybrid.evaluate.budgets import Tuning
from hybrid.evaluate.peers import Enlarged, Peer, Warped
from hybrid.metrics.similarity import ssim
from pathtrace.tracer import Tracer

_F = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)
_SPP = (1, 2, 4)


def tuned(
    tracer: Tracer,
    views: list[Camera],
    references: list[Image],
    gaze: Gaze,
    rays: float,
    progress: Callable[[int, int], None],
) -> Tuning:
    """The settings with the best mean SSIM of the whole frame, at a number of rays per pixel.

    Args:
        tracer: of the scene.
        views, references: to tune on.
        gaze: where the viewer looks.
        rays: per pixel of the frame.
        progress: called with settings tried and settings in all.
    """
    warped = {
        key: Warped(tracer, key[0], float(np.sqrt(key[1] / rays)), key[1], key[2])
        for key in product(_F, _SPP, (False, True))
    }
    enlarged = {spp: Enlarged(tracer, rays / spp, spp, True) for spp in _SPP}
    everything: Iterable[Peer] = [*warped.values(), *enlarged.values()]
    scores = []
    for number, peer in enumerate(everything):
        images = [peer.make(view, gaze, seed).image for seed, view in enumerate(views)]
        scores.append(np.mean([ssim(image, truth) for image, truth in zip(images, references, strict=True)]))
        progress(number + 1, len(warped) + len(enlarged))
    f, spp, denoised = list(warped)[int(np.argmax(scores[: len(warped)]))]
    return Tuning(f, spp, denoised, list(enlarged)[int(np.argmax(scores[len(warped) :]))])
