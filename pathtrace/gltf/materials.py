"""Materials of a glTF file (specification, 3.9) as Mitsuba's `principled`, which has the same parameters."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathtrace.gltf.document import Document
from pathtrace.gltf.textures import Textures, linear
from pathtrace.gltf.xml import plugin, value

Array = NDArray[np.float64]

_STRENGTH = "KHR_materials_emissive_strength"


class Materials:
    """The materials of a file, as Mitsuba's elements.

    Args:
        document: the file.
        textures: for their images.
        remarks: lines for the user are added to them.
    """

    def __init__(self, document: Document, textures: Textures, remarks: list[str]):
        self._document, self._textures, self._remarks = document, textures, remarks
        self._bsdfs: dict[tuple[int | None, bool], ET.Element] = {}

    @property
    def bsdfs(self) -> list[ET.Element]:
        """All that shapes refer to."""
        return list(self._bsdfs.values())

    def reference(self, material: int | None, coloured: bool, user: str) -> ET.Element:
        """What a shape refers to its material by; `coloured` if its vertices have colours."""
        key = (material, coloured)
        if key not in self._bsdfs:
            number = "default" if material is None else str(material)
            name = f"material-{number}{'-coloured' if coloured else ''}"
            self._bsdfs[key] = self._bsdf(self.item(material, user), name, coloured)
        return ET.Element("ref", {"id": self._bsdfs[key].attrib["id"]})

    def item(self, material: int | None, user: str) -> dict[str, Any]:
        """A material of the file; of a primitive without one, all that is default."""
        return {} if material is None else self._document.item("materials", material, user)

    def uv_set(self, material: int | None, user: str) -> int:
        """The set of texture coordinates that its textures have."""
        item = self.item(material, user)
        pbr = item.get("pbrMetallicRoughness", {})
        infos = [
            pbr.get("baseColorTexture"),
            pbr.get("metallicRoughnessTexture"),
            item.get("emissiveTexture"),
        ]
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
        radiance = linear(self._textures.pixels(info, user)[..., :3]) * factor
        if not radiance.any():
            return None
        return plugin("emitter", "area", self._textures.radiance("radiance", info, radiance))

    def _bsdf(self, item: dict[str, Any], name: str, coloured: bool) -> ET.Element:
        pbr = item.get("pbrMetallicRoughness", {})
        base = np.array(pbr.get("baseColorFactor", [1, 1, 1, 1]), dtype=np.float64)
        info, alpha = pbr.get("baseColorTexture"), base[3]
        if info is not None:
            pixels = self._textures.pixels(info, name)
            alpha = pixels[..., 3] * base[3]
            colour = self._textures.colour("base_color", info, linear(pixels[..., :3]) * base[:3])
        elif coloured:
            attribute = value("string", "name", "vertex_color")
            colour = plugin("texture", "mesh_attribute", attribute, name="base_color")
        else:
            colour = value("rgb", "base_color", base[:3])
        if "normalTexture" in item:
            self._remark("normal maps are left out")
        # The back of a surface would be black; what a viewer culls, a path tracer must show.
        inner = plugin("bsdf", "principled", colour, *self._surface(pbr, name))
        both = plugin("bsdf", "twosided", inner)
        bsdf = self._masked(item, info, alpha, both)
        bsdf.set("id", name)
        return bsdf

    def _surface(self, pbr: dict[str, Any], name: str) -> list[ET.Element]:
        """Roughness and metallic: factors, or the green and blue of a texture (3.9.2)."""
        factors = {"roughness": pbr.get("roughnessFactor", 1.0), "metallic": pbr.get("metallicFactor", 1.0)}
        info = pbr.get("metallicRoughnessTexture")
        if info is None:
            return [value("float", key, factor) for key, factor in factors.items()]
        pixels = self._textures.pixels(info, name)
        return [
            self._textures.amount(key, info, pixels[..., channel] * factors[key])
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
        return plugin("bsdf", "mask", self._textures.amount("opacity", info, amounts), inner)

    def _remark(self, line: str) -> None:
        if line not in self._remarks:
            self._remarks.append(line)
