"""3D Gaussians to images, on CPU and CUDA from one kernel source in Dr.Jit, and their training.

    import splat

    gaussians = splat.load_ply("scene.ply")
    image = splat.render(gaussians, camera)  # (H, W, 3) linear radiance; torch differentiates it

Names are imported when they are first used, so that `import splat` loads neither torch nor Dr.Jit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

# Imports compose, which points Dr.Jit to a good LLVM, before anything imports Dr.Jit.
from compose.base.startup import names_on_demand

if TYPE_CHECKING:
    from compose.camera.camera import Camera as Camera
    from compose.camera.camera import look_at as look_at
    from compose.camera.coordinate_systems import Place as Place
    from splat.io.forest_file import load_forest as load_forest
    from splat.io.forest_file import save_forest as save_forest
    from splat.io.ply import load_ply as load_ply
    from splat.io.ply import save_ply as save_ply
    from splat.model.forest import Forest as Forest
    from splat.model.gaussians import Gaussians as Gaussians
    from splat.raster.differentiable import render as render
    from splat.raster.rasterization import rasterization as rasterization

_MODULES = {
    "Camera": "compose.camera.camera",
    "Forest": "splat.model.forest",
    "Gaussians": "splat.model.gaussians",
    "Place": "compose.camera.coordinate_systems",
    "load_forest": "splat.io.forest_file",
    "load_ply": "splat.io.ply",
    "look_at": "compose.camera.camera",
    "rasterization": "splat.raster.rasterization",
    "render": "splat.raster.differentiable",
    "save_forest": "splat.io.forest_file",
    "save_ply": "splat.io.ply",
}
__all__ = sorted(_MODULES)
__getattr__, __dir__ = names_on_demand(__name__, _MODULES)
