"""The compact encoding of a forest's nodes: few bits per number, with errors that are bounded for any forest.

Niantic's SPZ files have similar bits. Here, coordinates have no fixed step, radiance has no largest value,
and trees are kept. What is decoded encodes to the same codes.

Sizes, opacities and colours are rounded to steps of equal size, chosen by what the eye and the rasterizer
see: their error is known for any Gaussian. Values that are rare take few bits once they are packed.

Quaternions take 33 bits: three components over the largest one, in steps of 1/511, with their signs, since a
learned field of deformations adds to quaternions.

Positions take 16 bits per axis, between the corners of boxes around few nodes, which follow each other along
a space-filling curve. Boxes are halved until their steps are finer than what they hold.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import expit

from splat.model.forest import Forest
from splat.model.gaussians import SH_DC, Directional, Gaussians, apart
from splat.model.points import Floats, Ints
from splat.model.trees import Layer

# Whole numbers of the type that a file has.
Codes = NDArray[Any]

# Steps per unit of a logarithm: sizes are right to 1.6 %. Any float32's exponent lies within the bound.
_PER_LOG, _MOST_LOG = 32, 128.0
# Below 1/255 nothing is drawn, above 0.99 nothing is told apart: eight bits are what opacity has.
_OPACITIES = 256
# Steps per unit of the perceptual scale: colours are right to 1/512, half a step of an 8-bit display, and so
# are harmonics up to the second degree together.
_PER_COLOUR = 256
# Larger colours and harmonics end there; both are inside of float32.
_LARGEST = 8e37


def codes_of_log_scales(log_scales: Floats) -> Codes:
    """Codes, int16, of natural logarithms of sizes; beyond those of float32's numbers they end."""
    return np.rint(np.clip(log_scales, -_MOST_LOG, _MOST_LOG) * _PER_LOG).astype(np.int16)


def log_scales_of_codes(codes: Codes) -> Floats:
    """Natural logarithms of sizes, within 1/64 of what was encoded."""
    return np.clip(codes / _PER_LOG, -_MOST_LOG, _MOST_LOG)


def codes_of_opacities(logits: Floats) -> Codes:
    """Codes, uint8, of opacities before the sigmoid."""
    return np.minimum(np.floor(expit(logits) * _OPACITIES), _OPACITIES - 1).astype(np.uint8)


def logits_of_codes(codes: Codes) -> Floats:
    """Opacities before the sigmoid; after it, within 1/512 of what was encoded, and inside of (0, 1)."""
    opacity = (codes + 0.5) / _OPACITIES
    return np.log(opacity / (1 - opacity))


def codes_of_constants(coefficients: Floats) -> Codes:
    """Codes, int16, of constant spherical harmonics: of the colours that they stand for."""
    return codes_of_harmonics(0.5 + SH_DC * coefficients)


def constants_of_codes(codes: Codes) -> Floats:
    """Constant harmonics; their colours are within 1/512, or of larger ones within that share."""
    return (harmonics_of_codes(codes) - 0.5) / SH_DC


def codes_of_harmonics(coefficients: Floats) -> Codes:
    """Codes, int16, of spherical harmonics that depend on direction.

    Steps 0, -1, 1, -2, ... become 0, 1, 2, 3, ...: small ones of both signs then have the same upper byte, 0.
    """
    # There are fewer than 2^15 steps of each sign.
    most = np.floor(_companded(np.array(_LARGEST)) * _PER_COLOUR)
    steps = np.clip(np.rint(_companded(coefficients) * _PER_COLOUR), -most, most).astype(np.int32)
    return ((steps << 1) ^ (steps >> 31)).astype(np.uint16).view(np.int16)


def harmonics_of_codes(codes: Codes) -> Floats:
    """Harmonics that depend on direction, within 1/512, or of larger ones within that share."""
    unsigned = codes.view(np.uint16).astype(np.int32)
    values = ((unsigned >> 1) ^ -(unsigned & 1)) / _PER_COLOUR
    size = np.abs(values)
    return np.where(size <= 1, values, np.copysign(np.exp(np.maximum(size, 1) - 1), values))


def _companded(values: Floats) -> Floats:
    """Values up to 1 as they are, larger ones by their logarithm: light has no largest value."""
    size = np.abs(values)
    return np.where(size <= 1, values, np.copysign(1 + np.log(np.maximum(size, 1)), values))


_TURN_STEPS = 511


def codes_of_rotations(quaternions: Floats) -> tuple[Codes, Codes]:
    """Codes of quaternions (4, N) of any length; that of length 0, which turns nothing, becomes (1, 0, 0, 0).

    Returns:
        (N,) uint8, which component is the largest, plus 4 if it is negative; and (3, N) int16, the others
        over it.
    """
    largest = np.abs(quaternions).max(axis=0)
    turned = np.where(largest > 0, quaternions, np.array([[1.0], [0], [0], [0]]))
    steps = np.rint(turned / np.where(largest > 0, largest, 1) * _TURN_STEPS).astype(np.int16)
    # Of components that are equally large after rounding, the first one.
    index = (np.abs(steps) == _TURN_STEPS).argmax(axis=0)[None]
    sign = np.sign(np.take_along_axis(steps, index, axis=0))
    others = np.take_along_axis(steps * sign, _others(index[0]), axis=0)
    return (index + 4 * (sign < 0))[0].astype(np.uint8), others


def rotations_of_codes(largest: Codes, others: Codes) -> Floats:
    """Quaternions (4, N), turned by at most 0.2 degrees, whose largest component is 1 or -1.

    ValueError if there is no such component, or another one is larger.
    """
    if len(largest) and (largest.max() >= 8 or np.abs(others.astype(np.int32)).max() > _TURN_STEPS):
        raise ValueError("rotations with codes that do not exist")
    index, sign = (largest % 4).astype(np.int64), np.where(largest >= 4, -1.0, 1.0)
    quaternions = np.empty((4, len(largest)))
    np.put_along_axis(quaternions, index[None], sign[None], axis=0)
    np.put_along_axis(quaternions, _others(index), sign * others / _TURN_STEPS, axis=0)
    return quaternions


def _others(index: Ints) -> Ints:
    """(3, N) the components besides those at an index (N,)."""
    others = np.arange(3)[:, None]
    return others + (others >= index)


_BOX_STEPS = 2**16 - 1
_LARGEST_BOX = 256
# A node's position is right to this share of its shortest axis, or of its longest one if it is a sheet.
_OF_SHORTEST, _OF_LONGEST = 1 / 16, 1 / 1024


@dataclass(frozen=True)
class Boxes:
    """B boxes around the N nodes of a forest, in their order."""

    counts: Codes  # (B,) int32, nodes in each
    low: NDArray[np.float32]  # low, high: (3, B) float32 corners
    high: NDArray[np.float32]
    codes: Codes  # (3, N) int16, of each node the steps from low to high, unsigned


def tolerance(log_scales: Floats) -> Floats:
    """(N,) furthest that a node may be moved, from logarithms of its axes (3, N)."""
    shortest, longest = (np.exp(extreme(log_scales, axis=0)) for extreme in (np.min, np.max))
    return np.maximum(_OF_SHORTEST * shortest, _OF_LONGEST * longest)


def boxed(means: Floats, tolerated: Floats, layers: tuple[int, ...]) -> Boxes:
    """Encodes positions (3, N), numbers of float32, in boxes of which none holds nodes of two layers.

    `tolerated` (N,) is the furthest that each may be moved, apart from float32's own rounding.
    """
    ends = np.cumsum(layers)
    starts = [np.arange(end - n, end, _LARGEST_BOX) for end, n in zip(ends, layers, strict=True)]
    # (B,) the first node of each box: halves of halves until all are small enough.
    first = np.concatenate(starts).astype(np.int64)
    while True:
        counts = np.diff(np.r_[first, means.shape[1]])
        low, high = _corners(means, first)
        error = np.linalg.norm((high - low) / (2 * _BOX_STEPS), axis=0)
        coarse = counts > 1
        if len(first):
            coarse &= error > np.minimum.reduceat(tolerated, first)
        if not coarse.any():
            break
        first = np.sort(np.r_[first, (first + counts // 2)[coarse]])
    wide, from_low = (np.repeat(part, counts, axis=1) for part in (high - low, low))
    share = (means - from_low) / np.where(wide > 0, wide, 1)
    codes = np.rint(share * _BOX_STEPS).astype(np.uint16).view(np.int16)
    return Boxes(counts.astype(np.int32), low.astype(np.float32), high.astype(np.float32), codes)


def unboxed(boxes: Boxes) -> Floats:
    """Positions (3, N), within the tolerance of what was encoded, corners exactly.

    ValueError if the boxes do not hold as many nodes as there are codes.
    """
    counts = boxes.counts.astype(np.int64)
    if (counts < 1).any() or counts.sum() != boxes.codes.shape[1]:
        raise ValueError("boxes that do not hold all positions")
    low, high = (np.repeat(part.astype(np.float64), counts, axis=1) for part in (boxes.low, boxes.high))
    share = boxes.codes.view(np.uint16) / _BOX_STEPS
    return low * (1 - share) + high * share


def _corners(means: Floats, first: Ints) -> tuple[Floats, Floats]:
    """(3, B) lowest and highest coordinates of nodes (3, N) from each index (B,) up to the next one."""
    if not len(first):
        return np.zeros((3, 0)), np.zeros((3, 0))
    return np.minimum.reduceat(means, first, axis=1), np.maximum.reduceat(means, first, axis=1)


_BOXES = "boxes."


def compact(forest: Forest) -> Forest:
    """The forest with numbers that a compact file holds exactly; of such a forest, the same numbers.

    ValueError if a number is not finite.
    """
    gaussians = decoded(encoded(forest.nodes, forest.counts)).gaussians
    gaussians = replace(gaussians, blending=forest.nodes.gaussians.blending)
    return replace(forest, nodes=replace(forest.nodes, gaussians=gaussians))


def exactly_encoded(forest: Forest) -> dict[str, torch.Tensor] | None:
    """Tensors as from `encoded` that hold the numbers of a forest exactly, to the bit; None if none do."""
    if not forest.nodes.gaussians.is_finite():
        return None
    codes = encoded(forest.nodes, forest.counts)
    both = (nodes.gaussians.every_tensor() for nodes in (forest.nodes, decoded(codes)))
    own, exact = ([tensor.detach().numpy().tobytes() for tensor in tensors] for tensors in both)
    return codes if own == exact else None


def encoded(nodes: Layer, counts: tuple[int, ...]) -> dict[str, torch.Tensor]:
    """Tensors by name that `decoded` takes, of the nodes of all layers and their counts per layer.

    ValueError if a number is not finite.
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
        "sh.turning": np.bincount(further.index.numpy()[turns], minlength=len(nodes)) > 0,
        # Parents follow each other as their children do.
        "parent": np.diff(parent, prepend=parent.dtype.type(0)),
    }
    labels = {"semantic": nodes.semantic, "dynamic": nodes.dynamic}
    return {name: torch.from_numpy(np.ascontiguousarray(part)) for name, part in codes.items()} | labels


def decoded(tensors: dict[str, torch.Tensor]) -> Layer:
    """The nodes that were encoded, within the errors that each encoding states.

    KeyError if a tensor is missing; ValueError if one has the wrong type or shape, or codes that do not
    exist.
    """
    codes: dict[str, Codes] = {}
    for name, (dtype, axes) in _KINDS.items():
        one = tensors[name]
        if one.dtype != dtype or one.ndim != axes:
            raise ValueError(f"{name} is {one.dtype} with {one.ndim} axes, expected {dtype} with {axes}")
        codes[name] = one.numpy()
    boxes = Boxes(**{field.name: codes[_BOXES + field.name] for field in fields(Boxes)})
    exact = lambda values: torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))  # noqa: E731
    directional = exact(harmonics_of_codes(codes["sh.directional"]).transpose(1, 2, 0))
    further = Directional(torch.from_numpy(np.flatnonzero(codes["sh.turning"])), directional)
    means, log_scales = unboxed(boxes), log_scales_of_codes(codes["log_scales"])
    rotations = rotations_of_codes(codes["rotations.largest"], codes["rotations.others"])
    shown = logits_of_codes(codes["opacities"]), constants_of_codes(codes["sh.constant"])[None]
    gaussians = Gaussians(*map(exact, (means, log_scales, rotations, *shown)), directional=further)
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
