"""The compact encoding of a forest's nodes: few bits per number, with errors that are bounded for any forest.

Niantic's SPZ files have similar bits. Here, coordinates have no fixed step, radiance has no largest value,
and trees are kept.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import torch

from splat.io.orientations import codes_of_rotations, rotations_of_codes
from splat.io.positions import Boxes, boxed, tolerance, unboxed
from splat.io.rounding import (
    Codes,
    codes_of_constants,
    codes_of_harmonics,
    codes_of_log_scales,
    codes_of_opacities,
    constants_of_codes,
    harmonics_of_codes,
    log_scales_of_codes,
    logits_of_codes,
)
from splat.model.forest import Forest
from splat.model.gaussians import Directional, Gaussians, apart
from splat.model.layer import Layer

_BOXES = "boxes."


def compact(forest: Forest) -> Forest:
    """The forest with numbers that a compact file holds exactly; of such a forest, the same numbers.

    Raises:
        ValueError: a number is not finite.
    """
    gaussians = decoded(encoded(forest.nodes, forest.counts)).gaussians
    return replace(forest, nodes=replace(forest.nodes, gaussians=gaussians))


def is_compact(forest: Forest) -> bool:
    """Whether a compact file holds its numbers exactly, to the bit."""
    return exactly_encoded(forest) is not None


def exactly_encoded(forest: Forest) -> dict[str, torch.Tensor] | None:
    """Tensors as of `encoded` that hold the numbers of a forest exactly, to the bit; None if none do."""
    if not forest.nodes.gaussians.is_finite():
        return None
    codes = encoded(forest.nodes, forest.counts)
    exact = _contents(forest.nodes.gaussians) == _contents(decoded(codes).gaussians)
    return codes if exact else None


def _contents(gaussians: Gaussians) -> list[bytes]:
    """All bits of Gaussians."""
    return [np.ascontiguousarray(t.detach().numpy()).tobytes() for t in gaussians.every_tensor()]


def encoded(nodes: Layer, counts: tuple[int, ...]) -> dict[str, torch.Tensor]:
    """Tensors by name that `decoded` takes.

    Args:
        nodes: of all layers.
        counts: nodes per layer.

    Raises:
        ValueError: a number is not finite.
    """
    gaussians = apart(nodes.gaussians)
    if not gaussians.is_finite():
        raise ValueError("a number is not finite")
    assert gaussians.directional is not None
    further = gaussians.directional
    directional = codes_of_harmonics(further.sh.detach().numpy().astype(np.float64))
    # What is rounded to nothing is left out.
    turns = directional.any(axis=(0, 1))
    exact = {name: t.detach().numpy().astype(np.float64) for name, t in gaussians.tensors()}
    log_scales = codes_of_log_scales(exact["log_scales"])
    boxes = boxed(exact["means"], tolerance(log_scales_of_codes(log_scales)), counts)
    largest, others = codes_of_rotations(exact["rotations"])
    parent = nodes.parent.numpy()
    codes = {
        **{_BOXES + field.name: getattr(boxes, field.name) for field in fields(Boxes)},
        "log_scales": log_scales,
        "rotations.largest": largest,
        "rotations.others": others,
        "opacities": codes_of_opacities(exact["opacity_logits"]),
        "sh.constant": codes_of_constants(exact["sh"][0]),
        # The coefficients of a node side by side: where one is small, others are.
        "sh.directional": directional[..., turns].transpose(2, 0, 1),
        "sh.turning": _mask(further.index.numpy()[turns], len(nodes)),
        # Parents follow each other as their children do.
        "parent": np.diff(parent, prepend=parent.dtype.type(0)),
    }
    labels = {"semantic": nodes.semantic, "dynamic": nodes.dynamic}
    return {name: torch.from_numpy(np.ascontiguousarray(part)) for name, part in codes.items()} | labels


def decoded(tensors: dict[str, torch.Tensor]) -> Layer:
    """The nodes that were encoded, within the errors that each encoding states.

    Raises:
        KeyError: a tensor is missing.
        ValueError: one has the wrong type or shape, or codes that do not exist.
    """
    codes = {name: _codes(tensors, name, kind) for name, kind in _KINDS.items()}
    boxes = Boxes(**{field.name: codes[_BOXES + field.name] for field in fields(Boxes)})
    directional = harmonics_of_codes(codes["sh.directional"]).transpose(1, 2, 0)
    further = Directional(
        torch.from_numpy(np.flatnonzero(codes["sh.turning"])),
        torch.from_numpy(np.ascontiguousarray(directional, dtype=np.float32)),
    )
    gaussians = Gaussians(
        *(
            torch.from_numpy(np.ascontiguousarray(part, dtype=np.float32))
            for part in (
                unboxed(boxes),
                log_scales_of_codes(codes["log_scales"]),
                rotations_of_codes(codes["rotations.largest"], codes["rotations.others"]),
                logits_of_codes(codes["opacities"]),
                constants_of_codes(codes["sh.constant"])[None],
            )
        ),
        directional=further,
    )
    parent = np.cumsum(codes["parent"], dtype=np.int32)
    return Layer(gaussians, *map(torch.from_numpy, (parent, codes["semantic"], codes["dynamic"])))


# Type and number of axes of each tensor of codes.
_KINDS: dict[str, tuple[torch.dtype, int]] = {
    "boxes.counts": (torch.int32, 1),
    "boxes.low": (torch.float32, 2),
    "boxes.high": (torch.float32, 2),
    "boxes.codes": (torch.int16, 2),
    "log_scales": (torch.int16, 2),
    "rotations.largest": (torch.uint8, 1),
    "rotations.others": (torch.int16, 2),
    "opacities": (torch.uint8, 1),
    "sh.constant": (torch.int16, 2),
    "sh.directional": (torch.int16, 3),
    "sh.turning": (torch.bool, 1),
    "parent": (torch.int32, 1),
    "semantic": (torch.int32, 1),
    "dynamic": (torch.bool, 1),
}


def _mask(index: Codes, count: int) -> Codes:
    """(N,) bool, true at an index, of N = `count`."""
    found = np.zeros(count, dtype=bool)
    found[index] = True
    return found


def _codes(tensors: dict[str, torch.Tensor], name: str, kind: tuple[torch.dtype, int]) -> Codes:
    """A tensor of codes; a ValueError if it is none."""
    tensor, (dtype, axes) = tensors[name], kind
    if tensor.dtype != dtype or tensor.ndim != axes:
        raise ValueError(f"{name} is {tensor.dtype} with {tensor.ndim} axes, expected {dtype} with {axes}")
    return tensor.numpy()
