"""How a cache follows a lamp that is dimmed: its bias from update to update, against caches filled anew."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from hybrid.bench.bias import PASS, advancing, block_errors, converged
from hybrid.frame.irradiance import filled_cache
from hybrid.measure.reference import REFERENCE_SEED
from hybrid.measure.timing import percentiles
from pathtrace.cache.cache import IrradianceCache
from pathtrace.fill.relight import PARTS, Relighting
from pathtrace.scene.scene import Scene
from pathtrace.trace.tracer import Tracer

# Updates after which the cache is looked at.
_UPDATES = (1, 4, 8, PARTS)
# Seeds of the caches filled anew.
_FRESH = (1, 2, 3)
# Images of many samples that are made.
_IMAGES = 2 + len(_UPDATES) + len(_FRESH)
# Parameters of lights that scale what they send.
_STRENGTHS = ("radiance.value", "irradiance.value", "intensity.value", "scale")


def bench_relighting(
    scene: Scene,
    camera: Camera,
    cache: IrradianceCache,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """Dims the strongest light of a scene by half, and puts it back afterwards.

    Args:
        scene, camera: what is rendered.
        cache: of the scene as it is.
        reference_spp: samples per pixel of the images that bias is measured in.
        progress: called with samples per pixel done and in total.

    Returns:
        `rows`: for each state of the cache (stale, 1, 4, 8 and 12 updates after the change, and filled anew
        with three seeds) the mean of the squared relative errors of blocks of 32 x 32 pixels, against an
        unbiased image; `update_ms`, of the updates after the first one. Both are empty if the light has no
        parameter that scales it.
    """
    passes = -(-reference_spp // PASS)
    advance = advancing(progress, _IMAGES * passes * PASS)
    rows: list[dict[str, Any]] = []
    milliseconds: list[float] = []
    with _dimmed(scene, int(cache.lights.chances[-1].argmax())) as is_dimmed:
        if not is_dimmed or not len(cache.cells):
            return {"rows": rows, "update_ms": {}}
        truth = converged(Tracer(scene), camera, passes, REFERENCE_SEED, advance)
        tracer, relighting = Tracer(scene, cache=cache), Relighting(scene, cache)

        def measure(state: str, with_cache: Tracer) -> None:
            image = converged(with_cache, camera, passes, REFERENCE_SEED + passes, advance)
            rows.append({"cache": state, "squared_bias": _squared(image, truth)})

        measure("stale", tracer)
        for number in range(1, PARTS + 1):
            start = time.perf_counter()
            tracer.relight(relighting.update())
            milliseconds.append(1000 * (time.perf_counter() - start))
            if number in _UPDATES:
                measure(f"{number} updates", tracer)
        for seed in _FRESH:
            measure(f"fresh {seed}", Tracer(scene, cache=filled_cache(scene, seed=seed)))
    return {"rows": rows, "update_ms": percentiles(milliseconds[1:])}


def _squared(image: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    return float((block_errors(image, truth) ** 2).mean())


@contextmanager
def _dimmed(scene: Scene, number: int) -> Iterator[bool]:
    """Halves what a light sends; whether it has a parameter for that."""
    parameters = mi.traverse(scene.mitsuba.emitters()[number])
    key = next((key for key in _STRENGTHS if key in parameters), None)
    if key is None:
        yield False
        return
    before = type(parameters[key])(parameters[key])
    try:
        parameters[key] = before * 0.5
        parameters.update()
        yield True
    finally:
        parameters[key] = before
        parameters.update()
