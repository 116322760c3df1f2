"""Small frames of the bundled scenes, against path-traced pictures of them that are stored.

`python -m tests.hybrid.render.test_pictures` makes the pictures anew, where a scene has changed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from compose.image.colour import srgb_from_radiance
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.image_files import write_png
from pathtrace.scene.scene import bundled_scenes, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import radiance_image
from pathtrace.trace.tracer import Tracer
from tests.hybrid.forests import rough_forest

PICTURES = Path(__file__).parent / "pictures"
SIZE = 96, 72
# In dB. Seen: 33 to 45, 17 to 19 and 6; untrained splats have no sky.
DISC, SPLATS, SPLATS_WITHOUT_SKY = 30.0, 14.0, 5.0
# Samples per pixel of the pictures, traced in passes.
PASS, PASSES = 64, 16
SETTINGS = FrameSettings(fov_a=45, fov_b=35, spp=32, fovea="denoised")


def psnr(image: NDArray[np.float32], picture: NDArray[np.float64], where: NDArray[np.bool_]) -> float:
    """In sRGB, over some pixels, in dB."""
    error = (srgb_from_radiance(image)[where].clip(0, 1) - picture[where]) ** 2
    return float(-10 * np.log10(error.mean()))


@pytest.mark.usefixtures("backend", "own_home")
@pytest.mark.parametrize("name", sorted(bundled_scenes()))
def test_a_frame_looks_as_its_scene_did(name):
    """The disc is nearly exact; splats that nothing has trained show what is where."""
    scene = load_scene(name)
    scene = replace(scene, camera=scene.camera.resized(*SIZE))
    frame = Renderer(scene, rough_forest(scene)).frame(SETTINGS, 1)
    picture = np.asarray(Image.open(PICTURES / f"{name}.png")) / 255
    weights = frame.settings.foveation.region(*SIZE).weight_image()
    assert psnr(frame.composite, picture, weights == 1) > DISC
    assert psnr(frame.composite, picture, weights == 0) > (SPLATS if name != "meadow" else SPLATS_WITHOUT_SKY)


if __name__ == "__main__":
    from pathtrace.scene.backend import select_backend

    select_backend()
    for name in bundled_scenes():
        tracer = Tracer(load_scene(name))
        camera = tracer.scene.camera.resized(*SIZE)
        frames = (
            radiance_image(tracer, camera, frame_positions(camera), camera.width, PASS, 100 + seed)
            for seed in range(PASSES)
        )
        write_png(PICTURES / f"{name}.png", sum(frames) / PASSES)
