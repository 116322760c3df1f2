"""Whether a scene looks here as Mitsuba itself renders it: by its own camera and integrator."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from compose.base.errors import UserError, one_line
from compose.image.colour import Image
from pathtrace.scene.loading import Source, load_mitsuba
from pathtrace.scene.optics import camera_of_sensor, perspective_sensor
from pathtrace.scene.scene import Scene, xml_of
from pathtrace.scene.scene_xml import read_description
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import radiance_image
from pathtrace.trace.tracer import Tracer

# Longer side of the pictures in pixels, sides of the blocks that are compared, and of each picture the number
# that are rendered, with so many samples per pixel.
_SIDE, _BLOCK, _PICTURES, _SPP = 64, 8, 8, 32
# Standard errors of a block's difference that count, of some hundred blocks with few pictures each; and its
# share of the brightest block around: reconstruction filters carry light across their borders.
_ERRORS, _SHARE = 6.0, 0.02
# Mitsuba's integrators whose light is that of paths, and their depth that is none.
_PATHS = "PathIntegrator", "VolumetricPathIntegrator", "VolumetricMisPathIntegrator"
_UNBOUNDED = (1 << 32) - 1


@dataclass(frozen=True)
class Parity:
    """How the pictures of a scene compare."""

    theirs: float  # mean radiance of Mitsuba's own picture
    ours: float  # that of the one here
    parts: int  # number of parts that were compared: blocks, and the whole picture
    differing: int  # number of those that differ by more than noise
    causes: tuple[str, ...] = ()  # what may make them differ besides what the scene leaves out, a line each
    by: str = "Mitsuba"  # what rendered their picture

    @property
    def holds(self) -> bool:
        """Whether they are the same but for noise."""
        return not self.differing


def parity(scene: Scene, source: str | Path | dict[str, Any], sensor: str | None = None) -> Parity:
    """Compares small pictures of a scene, as it was loaded from a source, with those of `mitsuba.render`.

    Where Mitsuba lacks its integrator, `path` or `volpath` stands in. UserError if it cannot render.
    """
    causes, integrator, by = list[str](), None, "Mitsuba"
    if scene.moving is not None:
        causes.append("what moves is as its motion file has it at the beginning, not as in the scene's file")
    try:
        own = _as_given(source, True)
        causes += _causes(own.integrator(), scene)
    except UserError:
        own = _as_given(source, False)
        kind = "volpath" if scene.optics.has_media else "path"
        integrator = mi.load_dict({"type": kind, "hide_emitters": scene.optics.hides_emitters})
        by = f"Mitsuba's {kind}, which does not have its integrator,"
    seen_by = perspective_sensor(own, scene.name, sensor)
    # About _SIDE pixels along the longer side of its crop window.
    film = mi.traverse(seen_by)
    names = [f"film.{name}" for name in ("size", "crop_offset", "crop_size")]
    scale = _SIDE / np.array(film[names[-1]]).max()
    for name in names:
        least = 0 if name.endswith("offset") else 1
        film[name] = np.maximum(np.round(np.array(film[name]) * scale), least).astype(int).tolist()
    film.update()
    tracer, small = Tracer(scene), scene.place.camera(camera_of_sensor(seen_by, scene.name))
    try:
        theirs = [_rendered(own, seen_by, integrator, number) for number in range(_PICTURES)]
    except RuntimeError as error:
        raise UserError(f"{scene.name}: Mitsuba does not render it: {one_line(error)}") from error
    ours = [
        radiance_image(tracer, small, frame_positions(small), small.width, _SPP, number)
        for number in range(_PICTURES)
    ]
    return replace(compared(np.stack(theirs), np.stack(ours)), causes=tuple(causes), by=by)


def _causes(integrator: mi.Integrator, scene: Scene) -> Iterator[str]:
    """What of a scene's own integrator is not as paths here are."""
    if integrator.class_name() not in _PATHS:
        yield f"its integrator is Mitsuba's {integrator.class_name()}, which shows other light than paths"
    if found := re.search(r"\bmax_depth = (\d+)", str(integrator)):
        depth = int(found[1]) if int(found[1]) < _UNBOUNDED else -1
        if depth != scene.max_depth:
            own, here = (f"after {n} segments" if n >= 0 else "nowhere" for n in (depth, scene.max_depth))
            yield f"paths of its integrator end {own}, here {here}"


def compared(theirs: NDArray[np.floating], ours: NDArray[np.floating]) -> Parity:
    """Compares independent pictures (P, H, W, 3) of the same, each with noise."""
    means = float(theirs.mean()), float(ours.mean())
    blocks = [_blocks(pictures.astype(np.float64)) for pictures in (theirs, ours)]
    whole = [np.mean(each, axis=(1, 2), keepdims=True) for each in blocks]
    differs = np.append(_differ(*blocks), _differ(*whole))
    return Parity(*means, differs.size, int(differs.sum()))


def _differ(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(R, C) which blocks of pictures (P, R, C, 3) differ by more than noise."""
    variance = (one.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / len(one)
    means = one.mean(axis=0), other.mean(axis=0)
    around = maximum_filter(np.maximum(*means), size=(3, 3, 1))
    bound = _ERRORS * np.sqrt(variance) + _SHARE * around
    return (np.abs(means[0] - means[1]) > bound).any(axis=-1)


def _as_given(source: str | Path | dict[str, Any], with_integrator: bool) -> mi.Scene:
    """The Mitsuba scene of a source, with its own integrator or with none; that of dictionaries stays."""
    if isinstance(source, dict):
        return load_mitsuba(Source("dictionary", source))
    file, text = xml_of(source)
    return load_mitsuba(Source(file.name, read_description(file, text, with_integrator).text, file.parent))


def _rendered(scene: mi.Scene, sensor: mi.Sensor, integrator: mi.Integrator | None, seed: int) -> Image:
    # By its stub, it takes no number as a seed, and no None.
    rendered = mi.render(scene, sensor=sensor, integrator=integrator, spp=_SPP, seed=seed)  # type: ignore[arg-type]
    image = np.array(rendered)
    colours: Image = image[..., :3] if image.shape[-1] >= 3 else np.repeat(image[..., :1], 3, axis=-1)
    return colours


def _blocks(pictures: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, R, C, 3) means of blocks of pictures (P, H, W, 3); those at the border may be smaller."""
    for axis in (1, 2):
        starts = np.arange(0, pictures.shape[axis], _BLOCK)
        sizes = np.diff(np.append(starts, pictures.shape[axis]))
        shape = [-1 if each == axis else 1 for each in range(4)]
        pictures = np.add.reduceat(pictures, starts, axis=axis) / sizes.reshape(shape)
    return pictures
