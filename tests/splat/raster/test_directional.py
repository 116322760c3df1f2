"""Radiance of Gaussians of which only some turn with the view, against the float64 twin of all."""

from __future__ import annotations

import pytest
import torch

from splat.model.gaussians import Directional, Gaussians
from splat.raster import differentiable as module
from splat.raster.differentiable import directional_radiance, render_differentiable, seen_from
from tests.splat.raster import reference
from tests.splat.raster.test_differentiable import smooth
from tests.splat.samples import camera, gaussians, leaves_of

N = 30


def mask() -> torch.Tensor:
    return torch.arange(N) % 3 == 1


def leaves(dtype: torch.dtype, degree: int = 2) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Parameters of all, and harmonics above the constant one, (K - 1, 3, M), of those in the mask."""
    g = gaussians(n=N, degree=degree).turning(mask())
    return leaves_of(g, dtype), g.directional.sh.to(dtype).clone().requires_grad_()


def apart(own: dict[str, torch.Tensor], further: torch.Tensor) -> Gaussians:
    index = torch.nonzero(mask())[:, 0][: further.shape[2]]
    return Gaussians(**own, directional=Directional(index, further))


def dense(own: dict[str, torch.Tensor], further: torch.Tensor) -> Gaussians:
    """The same with harmonics for all, for the twin."""
    return apart(own, further).all_turning()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_image_and_gradients_equal_the_twins(arrays, degree):
    cam, found = camera(), []
    weight = torch.randn(cam.height, cam.width, 3, generator=torch.Generator().manual_seed(1))
    for dtype in (torch.float32, torch.float64):
        own, further = leaves(dtype, degree)
        if dtype == torch.float32:
            image = render_differentiable(arrays, apart(own, further), cam)
        else:
            image = reference.render(dense(own, further), cam, 0.1)
        (image * weight.to(dtype)).sum().backward()
        gradients = {name: leaf.grad.double() for name, leaf in own.items()}
        if degree:
            gradients["further"] = further.grad.double()
        found.append((image.detach().double(), gradients))
    torch.testing.assert_close(found[0][0], found[1][0], atol=2e-4, rtol=1e-4)
    for name, value in found[1][1].items():
        error = (found[0][1][name] - value).abs().max() / value.abs().max()
        assert error < 2e-3, f"{name}: {error}"


def test_gradients_equal_finite_differences(arrays):
    """Of harmonics and of means, which tell the direction, along their own gradients."""
    cam = camera()
    weight = smooth(cam)
    own, further = leaves(torch.float32, 1)
    (render_differentiable(arrays, apart(own, further), cam) * weight).sum().backward()
    for name, leaf in (("further", further), ("means", own["means"]), ("sh", own["sh"])):
        direction, values = leaf.grad / leaf.grad.norm(), []
        for step in (-2e-3, 2e-3):
            moved = {k: v.detach() + (step * direction if k == name else 0) for k, v in own.items()}
            turned = further.detach() + (step * direction if name == "further" else 0)
            values.append((render_differentiable(arrays, apart(moved, turned), cam) * weight).sum().item())
        slope = (values[1] - values[0]) / 4e-3
        assert slope == pytest.approx(leaf.grad.norm().item(), rel=0.03), name


def test_what_an_eye_sees_is_constant_to_kernels():
    own, further = leaves(torch.float64)
    seen = seen_from(apart(own, further), camera().position)
    assert (seen.degree, seen.directional) == (0, None)
    direction = own["means"] - torch.tensor(camera().position)[:, None]
    basis = reference.harmonics(9, direction / direction.norm(dim=0))
    expected = torch.einsum("kcn,kn->cn", dense(own, further).sh, basis)
    torch.testing.assert_close(seen.sh[0] * basis[0], expected)


def test_time_and_memory_are_spent_on_those_alone(monkeypatch):
    """No harmonic is evaluated for others."""
    evaluated = []
    monkeypatch.setattr(
        module, "sh_basis", lambda count, d: evaluated.append(len(d[0])) or [torch.ones_like(d[0])] * count
    )
    own, further = leaves(torch.float32)
    seen_from(apart(own, further), camera().position)
    assert evaluated == [int(mask().sum())]


def test_a_gaussian_at_the_eye_has_finite_gradients():
    own, further = leaves(torch.float32)
    eye = own["means"][:, 4].detach().double().numpy()
    index = torch.nonzero(mask())[:, 0]
    directional_radiance(Directional(index, further), own["means"], eye).sum().backward()
    assert torch.isfinite(own["means"].grad).all()
    assert own["means"].grad.abs().max() < 1e4
