"""Materials and textures of a glTF file (specification, 3.8 and 3.9) as elements of a Mitsuba scene's XML.

Materials become Mitsuba's `principled`, which has the same parameters.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from compose.base.files import write_whole
from compose.camera.camera import Array
from compose.image.colour import bytes_from_radiance, radiance_from_srgb
from compose.image.exr import write_channels
from pathtrace.gltf.document import Document, read_view

_FOLDER = "textures"
# Mitsuba's names of OpenGL's; both directions wrap alike.
_WRAP = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_STRENGTH = "KHR_materials_emissive_strength"


def plugin(kind: str, plugin_type: str, *children: ET.Element, **attributes: str) -> ET.Element:
    """A shape, bsdf, texture, emitter or the like; attributes are its `id` and its `name`."""
    element = ET.Element(kind, {"type": plugin_type, **attributes})
    element.extend(children)
    return element


def value(kind: str, name: str, content: str | float | Iterable[float]) -> ET.Element:
    """A number, text, or colour by its name."""
    return ET.Element(
        kind, {"name": name, "value": content if isinstance(content, str) else numbers(content)}
    )


def to_world(matrix: Array) -> ET.Element:
    """A transform from a (4, 4) matrix."""
    element = ET.Element("transform", {"name": "to_world"})
    ET.SubElement(element, "matrix", {"value": numbers(matrix.ravel())})
    return element


def numbers(values: float | Iterable[float]) -> str:
    """Numbers as Mitsuba reads them; float32 keeps nine digits."""
    return ", ".join(f"{float(v):.9g}" for v in (values if isinstance(values, Iterable) else (values,)))


class Materials:
    """The materials of a file, as Mitsuba's elements, and its images as textures in the folder of a scene.

    `bsdfs` has all that shapes refer to, by the number of their material and whether vertices have colours.
    Lines for the user are added to the remarks.
    """

    def __init__(self, document: Document, folder: Path, remarks: list[str]):
        self._document, self._folder, self._remarks = document, folder, remarks
        self._written = 0
        self.bsdfs: dict[tuple[int | None, bool], ET.Element] = {}

    def reference(self, material: int | None, coloured: bool, user: str) -> ET.Element:
        """What a shape refers to its material by; `coloured` if its vertices have colours."""
        key = (material, coloured)
        if key not in self.bsdfs:
            number = "default" if material is None else str(material)
            name = f"material-{number}{'-coloured' if coloured else ''}"
            self.bsdfs[key] = self._bsdf(self.item(material, user), name, coloured)
        return ET.Element("ref", {"id": self.bsdfs[key].attrib["id"]})

    def item(self, material: int | None, user: str) -> dict[str, Any]:
        """A material of the file; of a primitive without one, all that is default."""
        return {} if material is None else self._document.item("materials", material, user)

    def uv_set(self, material: int | None, user: str) -> int:
        """The set of texture coordinates that its textures have."""
        item = self.item(material, user)
        pbr = item.get("pbrMetallicRoughness", {})
        infos = pbr.get("baseColorTexture"), pbr.get("metallicRoughnessTexture"), item.get("emissiveTexture")
        sets = [int(info["texCoord"]) for info in infos if info is not None]
        if len(set(sets)) > 1:
            self._remark(f"{user}: textures share the coordinates of the first one")
        return sets[0] if sets else 0

    def emitter(self, material: int | None, user: str) -> ET.Element | None:
        """An area light, of a material that shines."""
        item = self.item(material, user)
        strength = item.get("extensions", {}).get(_STRENGTH, {}).get("emissiveStrength", 1.0)
        factor = np.array(item.get("emissiveFactor", [0, 0, 0]), dtype=np.float64) * float(strength)
        if not factor.any():
            return None
        if "emissiveTexture" not in item:
            return plugin("emitter", "area", value("rgb", "radiance", factor))
        info = item["emissiveTexture"]
        radiance = radiance_from_srgb(self._pixels(info, user)[..., :3]) * factor
        if not radiance.any():
            return None
        return plugin("emitter", "area", self._radiance("radiance", info, radiance))

    def _bsdf(self, item: dict[str, Any], name: str, coloured: bool) -> ET.Element:
        pbr = item.get("pbrMetallicRoughness", {})
        base = np.array(pbr.get("baseColorFactor", [1, 1, 1, 1]), dtype=np.float64)
        info, alpha = pbr.get("baseColorTexture"), base[3]
        if info is not None:
            pixels = self._pixels(info, name)
            alpha = pixels[..., 3] * base[3]
            radiance = radiance_from_srgb(pixels[..., :3]) * base[:3]
            colour = self._colour("base_color", info, radiance)
        elif coloured:
            attribute = value("string", "name", "vertex_color")
            colour = plugin("texture", "mesh_attribute", attribute, name="base_color")
        else:
            colour = value("rgb", "base_color", base[:3])
        if "normalTexture" in item:
            self._remark("normal maps are left out")
        # The back of a surface would be black; what a viewer culls, a path tracer must show.
        both = plugin("bsdf", "twosided", plugin("bsdf", "principled", colour, *self._surface(pbr, name)))
        bsdf = self._masked(item, info, alpha, both)
        bsdf.set("id", name)
        return bsdf

    def _surface(self, pbr: dict[str, Any], name: str) -> list[ET.Element]:
        """Roughness and metallic: factors, or the green and blue of a texture (3.9.2)."""
        factors = {"roughness": pbr.get("roughnessFactor", 1.0), "metallic": pbr.get("metallicFactor", 1.0)}
        info = pbr.get("metallicRoughnessTexture")
        if info is None:
            return [value("float", key, factor) for key, factor in factors.items()]
        pixels = self._pixels(info, name)
        return [
            self._amount(key, info, pixels[..., channel] * factors[key])
            for channel, key in ((1, "roughness"), (2, "metallic"))
        ]

    def _masked(
        self, item: dict[str, Any], info: dict[str, Any] | None, alpha: float | Array, inner: ET.Element
    ) -> ET.Element:
        """A material with its transparency, if it has some (3.9.4)."""
        mode = item.get("alphaMode", "OPAQUE")
        amounts = np.asarray(alpha, dtype=np.float64)
        if mode == "MASK":
            amounts = (amounts >= item["alphaCutoff"]).astype(np.float64)
        if mode == "OPAQUE" or amounts.min() >= 1:
            return inner
        if info is None:
            return plugin("bsdf", "mask", value("float", "opacity", float(amounts)), inner)
        return plugin("bsdf", "mask", self._amount("opacity", info, amounts), inner)

    def _remark(self, line: str) -> None:
        if line not in self._remarks:
            self._remarks.append(line)

    def _pixels(self, info: dict[str, Any], user: str) -> Array:
        """(H, W, 4) red, green, blue, alpha of a texture, 0 to 1, as in its file; UserError if unreadable."""
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

    def _colour(self, name: str, info: dict[str, Any], radiance: Array) -> ET.Element:
        """A texture of colours in an sRGB file, from linear ones (H, W, 3), 0 to 1."""
        return self._png(name, info, bytes_from_radiance(radiance.astype(np.float32)), raw=False)

    def _amount(self, name: str, info: dict[str, Any], amounts: Array) -> ET.Element:
        """A texture of numbers (H, W), 0 to 1."""
        return self._png(name, info, np.round(np.clip(amounts, 0, 1) * 255).astype(np.uint8), raw=True)

    def _radiance(self, name: str, info: dict[str, Any], radiance: Array) -> ET.Element:
        """A texture of linear radiance (H, W, 3), without a bound."""
        channels = {channel: radiance[..., i].astype(np.float32) for i, channel in enumerate("RGB")}
        return self._element(name, info, "exr", lambda file: write_channels(file, channels), raw=True)

    def _png(self, name: str, info: dict[str, Any], pixels: NDArray[np.uint8], raw: bool) -> ET.Element:
        save = lambda part: PillowImage.fromarray(pixels).save(part, format="PNG")  # noqa: E731
        return self._element(name, info, "png", lambda file: write_whole(file, save), raw)

    def _element(
        self, name: str, info: dict[str, Any], kind: str, write: Callable[[Path], None], raw: bool
    ) -> ET.Element:
        self._written += 1
        file = f"{_FOLDER}/{self._written}.{kind}"
        write(self._folder / file)
        number = self._document.section("textures")[int(info["index"])].get("sampler")
        sampler = {} if number is None else self._document.item("samplers", number, "texture")
        wrap = value("string", "wrap_mode", _WRAP.get(sampler.get("wrapS", 10497), "repeat"))
        is_raw = value("boolean", "raw", str(raw).lower())
        return plugin("texture", "bitmap", value("string", "filename", file), is_raw, wrap, name=name)
