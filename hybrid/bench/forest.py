"""Costs of a forest: building it over Gaussians (Algorithm 1), loading it, and memory while rendering."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from compose.base.arrays import BackendName
from compose.camera.camera import Camera, camera_from_pose
from splat.io.forest_file import load_forest, save_forest
from splat.model.building import build_forest
from splat.model.forest import forest_of
from splat.model.gaussians import Gaussians, sh_count
from splat.model.layer import static_layer

_LAYERS = 4
_DEGREE = 2
# Side of a training pixel on the walls, in units of the room, whose sides are 2.
_PIXEL = 0.004
_FOCAL = 500.0
_SIZE = (1920, 1080)


def bench_forest(nodes: int, seed: int, backend: BackendName) -> dict[str, Any]:
    """Times and memory of a forest over random Gaussians on the walls of a room of 2 x 2 x 2.

    Args:
        nodes: number of Gaussians of the finest layer.
        seed: same seed, same forest.
        backend: that renders.

    Returns:
        finest, the number of nodes; layers, nodes of each; build_s; load_s, from the file to the device;
        peak_bytes of a separate process that loads the file and renders a frame of 1920 x 1080 under the
        default acuity model; nodes_drawn in that frame.
    """
    start = time.perf_counter()
    layers = build_forest(static_layer(_on_walls(nodes, np.random.default_rng(seed))), _PIXEL, _LAYERS)
    built = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.forest"
        save_forest(path, forest_of(layers, _FOCAL, "", ""))
        # Spawned, because a forked process starts with this one's memory.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            rendering = pool.apply(_loaded_and_rendered, (path, backend))
    return {
        "finest": nodes,
        "layers": [len(layer) for layer in layers],
        "build_s": built,
        **rendering,
    }


def _on_walls(count: int, rng: np.random.Generator) -> Gaussians:
    """Random Gaussians on the six walls."""
    means = rng.uniform(-1, 1, (3, count))
    wall = rng.integers(0, 6, count)
    means[wall % 3, np.arange(count)] = np.where(wall < 3, -1.0, 1.0)
    sizes = _PIXEL * rng.lognormal(0, 0.5, (3, count))
    parts = (
        means,
        np.log(sizes),
        rng.normal(size=(4, count)),
        rng.normal(1, 1, count),
        rng.normal(0, 0.3, (sh_count(_DEGREE), 3, count)),
    )
    return Gaussians(*(torch.tensor(part, dtype=torch.float32) for part in parts))


def _loaded_and_rendered(path: Path, backend: BackendName) -> dict[str, Any]:
    """Runs in a process of its own."""
    from hybrid.frame.periphery import Periphery
    from hybrid.frame.settings import FrameSettings
    from hybrid.runtime.device import device_arrays
    from hybrid.runtime.memory import peak_memory
    from pathtrace.base.backend import select_backend

    select_backend(backend)
    arrays = device_arrays()
    start = time.perf_counter()
    periphery = Periphery(arrays, load_forest(path))
    loaded = time.perf_counter() - start
    camera = _inside()
    settings = FrameSettings(fov_a=20, fov_b=20)
    region = settings.foveation.region(camera.width, camera.height)
    drawn = periphery.draw(camera, periphery.detail(camera, settings), region)
    drawn.image()
    return {"load_s": loaded, "peak_bytes": peak_memory(), "nodes_drawn": drawn.nodes}


def _inside() -> Camera:
    """A camera at the centre of the room, facing a wall."""
    width, height = _SIZE
    return camera_from_pose(np.eye(4), width, height, width / 1.2, width / 1.2, width / 2, height / 2)
