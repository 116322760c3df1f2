"""What a forest costs: growing it over Gaussians (Algorithm 1), loading it, and its memory at rendering."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from compose.camera.camera import Camera, camera_from_pose
from splat.base.arrays import BackendName
from splat.io.forest_file import load_forest, save_forest
from splat.model.building import build_forest
from splat.model.forest import forest_of
from splat.model.gaussians import Gaussians, sh_count
from splat.model.layer import static_layer

_LAYERS = 4
_DEGREE = 2
# A pixel of the training frames on the walls of the room that the Gaussians are drawn on, in its units.
_PIXEL = 0.004
_FOCAL = 500.0
_SIZE = (1920, 1080)


def bench_forest(nodes: int, seed: int, backend: BackendName) -> dict[str, Any]:
    """Times and memory of a forest over Gaussians drawn at random on the walls of a room of 2 x 2 x 2.

    Memory is the peak of a process of its own that loads the file and renders a frame of 1920x1080 under
    the default acuity model; loading is from the file to the first Gaussian on the device.

    Args:
        nodes: of the finest layer.
        seed: same seed, same forest.
        backend: that renders.
    """
    start = time.perf_counter()
    layers = build_forest(static_layer(_on_walls(nodes, np.random.default_rng(seed))), _PIXEL, _LAYERS)
    built = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.forest"
        save_forest(path, forest_of(layers, _FOCAL, "", ""))
        # Spawned, not forked: it must not begin with this process's memory.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            rendering = pool.apply(_loaded_and_rendered, (path, backend))
    return {
        "finest": nodes,
        "layers": [len(layer) for layer in layers],
        "build_s": built,
        **rendering,
    }


def _on_walls(count: int, rng: np.random.Generator) -> Gaussians:
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
    from hybrid.frame.periphery import Periphery
    from hybrid.frame.settings import FrameSettings
    from hybrid.runtime.device import device_arrays
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
    return {"load_s": loaded, "peak_bytes": _peak_bytes(), "nodes_drawn": drawn.nodes}


def _peak_bytes() -> int:
    """Most memory that this process ever held; getrusage would count that of the process that spawned it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024


def _inside() -> Camera:
    """From the middle of the room towards one of its walls."""
    width, height = _SIZE
    return camera_from_pose(np.eye(4), width, height, width / 1.2, width / 1.2, width / 2, height / 2)
