"""Fields against plain twins in float64, their gradients, and what they do before training."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import torch

from splat.model.choices import FieldKind
from splat.model.gaussians import Gaussians
from splat.model.motion import DeformationNetwork, HexPlane, LearnedMotion
from tests.splat.samples import gaussians

LOW, HIGH = torch.tensor([-1.0, -2.0, -0.5]), torch.tensor([1.0, 2.0, 3.0])
KINDS = list(FieldKind)


def begun(kind: FieldKind) -> LearnedMotion:
    return LearnedMotion.begun(kind, LOW, HIGH, 3)


def trained(kind: FieldKind) -> LearnedMotion:
    """As if after training: nothing is zero any more."""
    motion = begun(kind)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in motion.field.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=generator)
    return motion


def rows(layer: torch.nn.Module) -> tuple[np.ndarray, np.ndarray]:
    return tuple(p.detach().double().numpy() for p in (layer.weight, layer.bias))


def plain_heads(heads: torch.nn.Module, features: np.ndarray) -> list[np.ndarray]:
    found = []
    for name in ("shifts", "turns", "growths"):
        value = features
        for layer in getattr(heads, name):
            if isinstance(layer, torch.nn.Linear):
                weight, bias = rows(layer)
                value = weight @ value + bias
            else:
                value = np.maximum(value, 0)
        found.append(value)
    return found


def plain_network(field: DeformationNetwork, point: np.ndarray, time: float) -> list[np.ndarray]:
    """D-GS, equation by equation: frequencies 2^k without pi, and the encoding again after layer 4."""
    encoded = [*point]
    for k in range(10):
        encoded += [*np.sin(2.0**k * point), *np.cos(2.0**k * point)]
    encoded += [time]
    for k in range(6):
        encoded += [np.sin(2.0**k * time), np.cos(2.0**k * time)]
    features = encoded = np.array(encoded)
    for index, layer in enumerate(field.layers):
        weight, bias = rows(layer)
        features = np.maximum(weight @ features + bias, 0)
        if index == 4:
            features = np.concatenate([encoded, features])
    return plain_heads(field.heads, features)


def plain_hexplane(field: HexPlane, point: np.ndarray, time: float) -> list[np.ndarray]:
    """4DGS: the product of six planes at each resolution, linear between their cells."""
    low, high = LOW.double().numpy(), HIGH.double().numpy()
    place = np.clip([*((point - low) / (high - low)), time], 0, 1)
    features = []
    planes = [plane.detach().double().numpy()[0] for plane in field.planes]
    for level in range(2):
        product = np.ones(32)
        for number, (a, b) in enumerate(combinations(range(4), 2)):
            plane = planes[6 * level + number]
            y, x = place[b] * (plane.shape[1] - 1), place[a] * (plane.shape[2] - 1)
            row, column = min(int(y), plane.shape[1] - 2), min(int(x), plane.shape[2] - 2)
            v, u = y - row, x - column
            corners = plane[:, row : row + 2, column : column + 2]
            product = product * np.einsum("fij,i,j->f", corners, [1 - v, v], [1 - u, u])
        features.append(product)
    weight, bias = rows(field.mix)
    return plain_heads(field.heads, np.maximum(weight @ np.concatenate(features) + bias, 0))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("time", [0.0, 0.37, 1.0])
def test_fields_are_those_of_their_papers(kind, time):
    field = trained(kind).field
    points = np.random.default_rng(0).uniform(-2.5, 3.5, (20, 3))
    plain = plain_network if kind is FieldKind.D_GS else plain_hexplane
    found = field(torch.from_numpy(points.T).float(), time)
    expected = [np.stack(part, axis=1) for part in zip(*(plain(field, p, time) for p in points), strict=True)]
    for part, right in zip((found.shifts, found.turns, found.growths), expected, strict=True):
        np.testing.assert_allclose(part.detach(), right, rtol=2e-3, atol=2e-3 * np.abs(right).max())


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_those_of_finite_differences(kind):
    field = trained(kind).field.double()
    # Seeded: near a kink of a rectifier, differences are those of two slopes.
    points = torch.rand(3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 0.5
    parameter = field.heads.shifts[0].weight
    last = next(p for p in field.parameters() if p.ndim > 1)

    def of(points: torch.Tensor) -> tuple[torch.Tensor, ...]:
        found = field(points, 0.4)
        return found.shifts, found.turns, found.growths

    assert torch.autograd.gradcheck(of, points.requires_grad_(), eps=1e-7, atol=1e-4)
    for tensor in (parameter, last):
        index = tuple(0 for _ in tensor.shape) if tensor is parameter else strongest(field, points, tensor)
        (slope,) = torch.autograd.grad(sum(part.square().sum() for part in of(points)), tensor)
        with torch.no_grad():
            before = tensor[index].item()
            ends = []
            for step in (1e-6, -1e-6):
                tensor[index] = before + step
                ends.append(float(sum(part.square().sum() for part in of(points))))
            tensor[index] = before
        assert float(slope[index]) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4, abs=1e-8)


def strongest(field: torch.nn.Module, points: torch.Tensor, tensor: torch.Tensor) -> tuple[int, ...]:
    """Index of the parameter that matters most: most cells of a plane see no point."""
    (slope,) = torch.autograd.grad(field(points, 0.4).shifts.square().sum(), tensor)
    return tuple(int(i) for i in np.unravel_index(int(slope.abs().argmax()), tuple(slope.shape)))


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_deformed_before_training(kind):
    g = gaussians("overlap", 30, 1)
    found = begun(kind).shown(g, torch.zeros(30, dtype=torch.int32), 0.6)
    np.testing.assert_array_equal(found.means.detach(), g.means)
    np.testing.assert_array_equal(found.log_scales.detach(), g.log_scales)
    unit = g.rotations / g.rotations.norm(dim=0)
    np.testing.assert_allclose(found.rotations.detach(), unit, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_only_what_belongs_to_an_instance_is_deformed(kind):
    g, motion = gaussians("overlap", 30, 1), trained(kind)
    instance = torch.arange(30, dtype=torch.int32) % 3 - 1
    some, every = (motion.shown(g, i, 0.6) for i in (instance, torch.zeros(30, dtype=torch.int32)))
    moving = instance >= 0
    for name, tensor in g.tensors():
        found, whole = getattr(some, name).detach(), getattr(every, name).detach()
        torch.testing.assert_close(found[..., ~moving], tensor[..., ~moving], rtol=0, atol=0)
        torch.testing.assert_close(found[..., moving], whole[..., moving])
    assert motion.shown(g, torch.full((30,), -1), 0.6) is g


@pytest.mark.parametrize("kind", KINDS)
def test_the_way_back_is_right_to_first_order(kind):
    """Where a field changes slowly, what is brought back is shown where it was."""
    motion, g = trained(kind), gaussians("overlap", 30, 1)
    with torch.no_grad():
        for parameter in motion.field.heads.parameters():
            parameter *= 1e-3
    none = torch.zeros(30, dtype=torch.int32)
    back = motion.shown(motion.at_rest(g, none, 0.3), none, 0.3)
    moved = float((motion.shown(g, none, 0.3).means.detach() - g.means).abs().max())
    assert moved > 1e-6
    assert float((back.means.detach() - g.means).abs().max()) < 0.3 * moved


@pytest.mark.parametrize("kind", KINDS)
def test_a_field_comes_back_from_its_tensors(kind):
    motion, g = trained(kind), gaussians("overlap", 10, 0)
    back = LearnedMotion.restored(motion.tensors())
    none = torch.zeros(10, dtype=torch.int32)
    a, b = (m.shown(g, none, 0.5) for m in (motion, back))
    for name in ("means", "rotations", "log_scales"):
        torch.testing.assert_close(getattr(a, name), getattr(b, name), rtol=0, atol=0)
    assert (back.kind, len(back)) == (kind, len(motion))


def test_a_single_gaussian_can_be_deformed():
    g = gaussians("overlap", 1, 0)
    for kind in KINDS:
        found = trained(kind).shown(g, torch.zeros(1, dtype=torch.int32), 1.0)
        assert isinstance(found, Gaussians)
        assert found.is_finite()
