"""A picture of a frame and of its parts: what is traced, what is splatted, and how they are joined.

python examples/parts_of_a_frame.py room room.forest parts.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import hybrid

_SIZE = 400
_MARGIN, _CAPTION = 8, 26


def main() -> None:
    parser = argparse.ArgumentParser(description="Draws a hybrid frame and its parts side by side.")
    parser.add_argument("scene", help="name of a bundled scene, or a Mitsuba XML file")
    parser.add_argument("forest", type=Path, help="forest file")
    parser.add_argument("output", type=Path, help="PNG file to write")
    arguments = parser.parse_args()

    scene = hybrid.load_scene(arguments.scene)
    renderer = hybrid.Renderer(scene, hybrid.load_forest(arguments.forest))
    camera = scene.camera.resized(_SIZE, _SIZE)
    settings = hybrid.FrameSettings((0.42, 0.55), fov_a=24, fov_b=16, spp=16, camera=camera, aovs=("splat",))
    frame = renderer.frame(settings)
    aovs = frame.aovs()

    weight = aovs["weight"][..., None]
    shares = np.stack([aovs[f"fusion.{name}"] for name in ("traced", "denoised", "splat")], axis=-1)
    parts = {
        "the frame": _with_circles(_srgb(aovs["composite"]), settings),
        "path-traced samples": _srgb(aovs["path-traced"] * (weight > 0)),
        "shares: denoised green, splats blue": (255 * shares).astype(np.uint8),
        "splatted periphery": _srgb(aovs["splat"] * (1 - weight)),
    }
    _side_by_side(parts).save(arguments.output)
    print(arguments.output)


def _srgb(radiance: np.ndarray) -> np.ndarray:
    """(H, W, 3) 8-bit sRGB of linear radiance."""
    linear = np.clip(radiance, 0, 1)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (curve * 255 + 0.5).astype(np.uint8)


def _with_circles(image: np.ndarray, settings: hybrid.FrameSettings) -> np.ndarray:
    """The image with the radii fov-a and fov-b drawn around the gaze."""
    picture = Image.fromarray(image)
    draw = ImageDraw.Draw(picture)
    height, width = image.shape[:2]
    x, y = settings.gaze.pixel(width, height)
    for percent in (settings.fov_a, settings.fov_b):
        radius = percent / 100 * height
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline="white")
    return np.asarray(picture)


def _side_by_side(parts: dict[str, np.ndarray]) -> Image.Image:
    step = _SIZE + _MARGIN
    sheet = Image.new("RGB", (len(parts) * step - _MARGIN, _SIZE + _CAPTION), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(16)
    for number, (caption, image) in enumerate(parts.items()):
        sheet.paste(Image.fromarray(image), (number * step, 0))
        draw.text((number * step + 2, _SIZE + 3), caption, "black", font)
    return sheet


if __name__ == "__main__":
    main()
