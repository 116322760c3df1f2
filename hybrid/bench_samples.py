"""Samples where they help, against as many in every pixel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hybrid.bench_fovea import crops, means, measured, reference, unfitted_views, whole_plan, whole_underlay
from hybrid.fovea import Fovea
from hybrid.fusing import fusion_of
from hybrid.periphery import Periphery, Viewing
from pathtrace.frames import FrameSet
from pathtrace.scene import Scene
from pathtrace.tracer import Tracer
from splat.arrays import Arrays
from splat.forest import Forest


def bench_samples(
    arrays: Arrays,
    scene: Scene,
    frames: FrameSet,
    forest: Forest,
    counts: tuple[int, ...],
    seeds: int,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per resolution, sample count and distribution: the fused fovea, means over views and seeds.

    Args:
        arrays, scene, forest: what is rendered.
        frames: that the forest was trained on; its unfitted views are measured.
        counts: samples per pixel, on the mean.
        seeds: runs of each.
        reference_spp: samples per pixel of the references.
        progress: called with crops done and crops in all.
    """
    fovea = Fovea(Tracer(scene), "fused", fusion_of(forest))
    periphery = Periphery(arrays, forest, Viewing(law="none"))
    found: dict[tuple[int, int, str], list[dict[str, float]]] = {}
    places = list(crops(unfitted_views(frames), (1, 2), 0.4))
    for done, crop in enumerate(places):
        camera, plan = crop.camera, whole_plan(crop.camera)
        truth, _ = reference(fovea.tracer, camera, reference_spp, 1_000_003)
        under = whole_underlay(periphery, camera)
        for spp in counts:
            for seed in range(seeds):
                for name, guide in (("uniform", None), ("adaptive", under)):
                    samples = fovea.trace(camera, plan, spp, seed, guide)
                    radiance = fovea.picture(camera, plan, samples, under.radiance, under).radiance
                    row = measured(radiance.reshape(camera.height, camera.width, 3), truth)
                    row["rays"] = float(samples.count.sum())
                    found.setdefault((crop.scale, spp, name), []).append(row)
        progress(done + 1, len(places))
    return [
        {
            "scene": scene.name,
            "scale": scale,
            "spp": spp,
            "method": name,
            **means(rows),
        }
        for (scale, spp, name), rows in found.items()
    ]
