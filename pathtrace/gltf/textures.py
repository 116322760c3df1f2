"""Images of a glTF file (specification, 3.8) as files that Mitsuba reads."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from compose.base.files import write_whole
from compose.image.colour import bytes_from_radiance
from compose.image.exr import write_channels
from pathtrace.gltf.accessors import read_view
from pathtrace.gltf.document import Document
from pathtrace.gltf.xml import plugin, value

Array = NDArray[np.float64]

_FOLDER = "textures"
# Mitsuba's names of OpenGL's; both directions wrap alike.
_WRAP = {10497: "repeat", 33071: "clamp", 33648: "mirror"}


class Textures:
    """The images of a file, as textures in the folder of a scene.

    Args:
        document: the file.
        folder: of the scene.
    """

    def __init__(self, document: Document, folder: Path):
        self._document, self._folder = document, folder
        self._written = 0

    def pixels(self, info: dict[str, Any], user: str) -> Array:
        """(H, W, 4) red, green, blue and alpha of a texture, 0 to 1, as its file has them.

        Raises:
            UserError: there is no such texture, or its image cannot be read.
        """
        texture = self._document.item("textures", info["index"], user)
        if "source" not in texture:
            raise self._document.refused(f"{user}: textures[{info['index']}] has no image that is known here")
        image = self._document.item("images", texture["source"], user)
        name = f"images[{texture['source']}]"
        if "uri" in image:
            content = self._document.resource(image["uri"], name)
        else:
            content = read_view(self._document, image["bufferView"], name)[0]
        try:
            with PillowImage.open(io.BytesIO(content)) as opened:
                return np.asarray(opened.convert("RGBA"), dtype=np.float64) / 255
        except (OSError, ValueError, PillowImage.DecompressionBombError) as error:
            raise self._document.refused(f"{name} cannot be read as an image ({error})") from error

    def colour(self, name: str, info: dict[str, Any], radiance: Array) -> ET.Element:
        """A texture of colours in an sRGB file, from linear ones (H, W, 3), 0 to 1."""
        return self._png(name, info, bytes_from_radiance(radiance.astype(np.float32)), raw=False)

    def amount(self, name: str, info: dict[str, Any], amounts: Array) -> ET.Element:
        """A texture of numbers (H, W), 0 to 1."""
        return self._png(name, info, np.round(np.clip(amounts, 0, 1) * 255).astype(np.uint8), raw=True)

    def radiance(self, name: str, info: dict[str, Any], radiance: Array) -> ET.Element:
        """A texture of linear radiance (H, W, 3), without a bound."""
        channels = {channel: radiance[..., i].astype(np.float32) for i, channel in enumerate("RGB")}
        file = self._new_file("exr")
        write_channels(self._folder / file, channels)
        return self._element(name, info, file, raw=True)

    def _png(self, name: str, info: dict[str, Any], pixels: NDArray[np.uint8], raw: bool) -> ET.Element:
        file, image = self._new_file("png"), PillowImage.fromarray(pixels)
        write_whole(self._folder / file, lambda part: image.save(part, format="PNG"))
        return self._element(name, info, file, raw)

    def _new_file(self, extension: str) -> str:
        self._written += 1
        return f"{_FOLDER}/{self._written}.{extension}"

    def _element(self, name: str, info: dict[str, Any], file: str, raw: bool) -> ET.Element:
        texture = self._document.section("textures")[int(info["index"])]
        sampler = (
            self._document.item("samplers", texture["sampler"], "texture") if "sampler" in texture else {}
        )
        return plugin(
            "texture",
            "bitmap",
            value("string", "filename", file),
            value("boolean", "raw", str(raw).lower()),
            value("string", "wrap_mode", _WRAP.get(sampler.get("wrapS", 10497), "repeat")),
            name=name,
        )


def linear(srgb: Array) -> Array:
    """Linear colour from the sRGB curve (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
