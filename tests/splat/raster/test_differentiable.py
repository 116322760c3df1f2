"""Rendering for torch against its float64 twin: the image and the gradient by every parameter."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import drjit as dr
import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.camera.camera import Camera
from splat.model.gaussians import Gaussians
from splat.raster import differentiable
from splat.raster.differentiable import aligned_rows, render, render_differentiable
from tests.splat.raster import reference
from tests.splat.samples import KINDS, camera, gaussians, leaves_of, white_dot


def both(arrays, g: Gaussians, cam: Camera, low_pass: float, weight: torch.Tensor):
    """Images and gradients by every parameter of sum(weight * image), of kernel and twin."""
    results = []
    for dtype, rendered in (
        (torch.float32, lambda p: render_differentiable(arrays, p, cam, low_pass)),
        (torch.float64, lambda p: reference.render(p, cam, low_pass)),
    ):
        leaves = leaves_of(g, dtype)
        image = rendered(Gaussians(**leaves))
        (image * weight.to(dtype)).sum().backward()
        results.append((image.detach().double(), {k: v.grad.double() for k, v in leaves.items()}))
    return results


def assert_equal_but_for_steps(image: torch.Tensor, expected: torch.Tensor) -> None:
    """Images agree; where an alpha lies at the cut of 1/255 itself, rounding decides whether it counts.

    Worst seen elsewhere: 1.1e-4 where a block stopped at a transmittance of 1e-4, else 4e-6.
    """
    error = (image - expected).abs()
    assert (error > 2e-4 + 1e-4 * expected.abs()).double().mean() < 1e-3
    assert error.max() < expected.max() / 255


def smooth(cam: Camera) -> torch.Tensor:
    """(H, W, 3) weights that vary slowly."""
    x, y = torch.meshgrid(torch.arange(cam.width), torch.arange(cam.height), indexing="xy")
    return torch.stack([torch.sin(x / 9.0), torch.cos(y / 7.0), torch.sin((x + y) / 11.0)], dim=-1)


@pytest.mark.parametrize("kind", KINDS)
def test_image_and_gradients_equal_the_twins(arrays, kind):
    g, cam = gaussians(kind), camera()
    weight = torch.randn(cam.height, cam.width, 3, generator=torch.Generator().manual_seed(1))
    (image, gradients), (expected, expected_gradients) = both(arrays, g, cam, 0.1, weight)
    assert_equal_but_for_steps(image, expected)
    for name, value in expected_gradients.items():
        scale = value.abs().max()
        assert scale > 0
        # Relative to the largest gradient of its kind: 6e-4 at the steps of 1/255, where rounding decided as
        # in the twin; a splat that it decided otherwise for is one of dozens.
        error = (gradients[name] - value).abs() / scale
        assert (error > 2e-3).double().mean() < 0.05, f"{name}: {error.max()}"
        assert error.max() < 2e-2, f"{name}: {error.max()}"


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_lower_degrees_equal_the_twin_too(arrays, degree):
    g, cam = gaussians(n=20, degree=degree), camera()
    weight = torch.ones(cam.height, cam.width, 3)
    (image, gradients), (expected, expected_gradients) = both(arrays, g, cam, 0.3, weight)
    torch.testing.assert_close(image, expected, atol=2e-4, rtol=1e-4)
    scale = expected_gradients["sh"].abs().max()
    assert (gradients["sh"] - expected_gradients["sh"]).abs().max() < 2e-3 * scale


def test_gradients_equal_finite_differences(arrays):
    """Along each parameter's own gradient, under a smooth weight.

    The cut at 1/255 moves with a Gaussian's edge, which the gradient leaves out; under a weight that varies
    slowly, what it adds on one side it removes on the other.
    """
    g, cam = gaussians("overlap", n=25, degree=1), camera()
    weight, leaves = smooth(cam), leaves_of(g)
    (render_differentiable(arrays, Gaussians(**leaves), cam) * weight).sum().backward()
    for name, leaf in leaves.items():
        # Uphill, the derivative is as large as it gets, and rounding matters least.
        direction = leaf.grad / leaf.grad.norm()
        values = []
        for step in (-2e-3, 2e-3):
            moved = {k: v.detach() + (step * direction if k == name else 0) for k, v in leaves.items()}
            values.append((render_differentiable(arrays, Gaussians(**moved), cam) * weight).sum().item())
        slope = (values[1] - values[0]) / 4e-3
        assert slope == pytest.approx(leaf.grad.norm().item(), rel=0.03), name


def test_one_gaussian_has_the_closed_form(arrays):
    """Standard deviation 0.5 at depth 4 with f 40 is 5 px; at its centre alpha is the compensated opacity."""
    cam = Camera(np.eye(4), 33, 33, 40.0, 40.0, 16.5, 16.5)
    image = render_differentiable(arrays, white_dot(4.0, 0.5), cam, 0.3)
    compensation = 25 / 25.3
    assert image[16, 16, 0].item() == pytest.approx(0.5 * compensation, rel=1e-5)
    expected = 0.5 * compensation * np.exp(-(5**2) / (2 * 25.3))
    assert image[16, 21, 1].item() == pytest.approx(expected, rel=1e-4)


def test_the_same_input_gives_the_same_bits(arrays):
    g, cam = gaussians("overlap", n=300), camera(70, 50)
    weight = torch.randn(cam.height, cam.width, 3, generator=torch.Generator().manual_seed(1))
    runs = []
    for _ in range(2):
        leaves = leaves_of(g)
        (render_differentiable(arrays, Gaussians(**leaves), cam) * weight).sum().backward()
        runs.append([leaf.grad for leaf in leaves.values()])
    for first, second in zip(*runs, strict=True):
        assert torch.equal(first, second)


@pytest.mark.parametrize("extreme", ["huge", "tiny", "at the camera", "zero quaternion", "NaN"])
def test_extremes_give_finite_images_and_gradients(arrays, extreme):
    g, cam = gaussians("overlap", n=20), camera()
    if extreme == "huge":
        g.log_scales[:, 0] = 12
    if extreme == "tiny":
        g.log_scales[:, 0] = -30
    if extreme == "at the camera":
        g.means[:, 0] = torch.tensor(cam.position, dtype=torch.float32)
    if extreme == "zero quaternion":
        g.rotations[:, 0] = 0
    if extreme == "NaN":
        g.means[:, 0] = float("nan")
    leaves = leaves_of(g)
    image = render_differentiable(arrays, Gaussians(**leaves), cam)
    image.sum().backward()
    assert torch.isfinite(image).all()
    for name, leaf in leaves.items():
        finite = leaf.grad[..., 1:] if extreme == "NaN" else leaf.grad
        assert torch.isfinite(finite).all(), name


def test_nothing_to_draw_is_black_and_has_zero_gradients(arrays):
    g = gaussians("overlap", n=5)
    g.means[2] = -50
    leaves = leaves_of(g)
    image = render_differentiable(arrays, Gaussians(**leaves), camera())
    assert image.abs().max() == 0
    image.sum().backward()
    assert all(leaf.grad.abs().max() == 0 for leaf in leaves.values())


def test_rows_lie_in_the_order_of_the_tensors(arrays):
    """The gradient's rows are put back in this order."""
    g = gaussians(n=4, degree=1)
    tensors = [tensor for _, tensor in g.tensors()]
    rows = [row.numpy() for row in aligned_rows(arrays, tensors)]
    np.testing.assert_array_equal(rows, torch.cat([tensor.reshape(-1, 4) for tensor in tensors]).numpy())


@pytest.mark.parametrize("n", [1, 16, 23])
def test_rows_start_where_vectors_are_aligned(arrays, n):
    """Whatever their number: the same kernels serve all."""
    rows = aligned_rows(arrays, [tensor for _, tensor in gaussians(n=n, degree=1).tensors()])
    addresses = [arrays.to_torch(row, torch.device("cpu")).data_ptr() for row in rows]
    assert [address % 64 for address in addresses] == [0] * len(rows)


@pytest.mark.parametrize(("n", "shared"), [(32, True), (23, False)])
def test_aligned_rows_share_the_memory(arrays, n, shared):
    if arrays.backend != "llvm":
        pytest.skip("tensors on the CPU are copied to the device")
    tensors = [tensor for _, tensor in gaussians(n=n, degree=1).tensors()]
    tensors[1] = tensors[1][:, torch.arange(n - 1, -1, -1)].T.contiguous().T
    rows = aligned_rows(arrays, tensors)
    values = torch.cat([tensor.reshape(-1, n) for tensor in tensors])
    np.testing.assert_array_equal([row.numpy() for row in rows], values.numpy())
    addresses = [arrays.to_torch(row, torch.device("cpu")).data_ptr() for row in rows]
    assert (addresses[0] == tensors[0].data_ptr()) is shared
    assert (addresses[-1] == tensors[-1][-1, -1].data_ptr()) is shared


def test_tensors_that_change_before_the_gradient_are_refused(arrays):
    """It would be that of other Gaussians."""
    leaves = leaves_of(gaussians(n=16))
    image = render_differentiable(arrays, Gaussians(**leaves), camera())
    with torch.no_grad():
        leaves["means"] += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.sum().backward()


def test_no_llvm_is_one_line(monkeypatch):
    monkeypatch.setattr(differentiable, "LLVM", UserError("no LLVM found"))
    differentiable._arrays.cache_clear()
    with pytest.raises(UserError, match="no LLVM found"):
        render(gaussians(n=3), camera())


def test_the_backend_follows_the_tensors(arrays):
    g, cam = gaussians(), camera()
    image = render(g, cam)
    assert image.shape == (36, 40, 3)
    assert image.dtype == torch.float32
    assert image.device.type == "cpu"
    if arrays.backend == "llvm":
        assert torch.equal(image, render_differentiable(arrays, g, cam))
    if torch.cuda.is_available():
        there = render(Gaussians(**{name: tensor.cuda() for name, tensor in g.tensors()}), cam)
        assert there.device.type == "cuda"
        torch.testing.assert_close(there.cpu(), image, atol=2e-4, rtol=1e-4)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_what_torch_does_on_a_stream_of_its_own_comes_first():
    """The Gaussians and the gradient of the image are only there after work that takes a while."""
    g, cam = gaussians(n=32), camera()
    leaves = {name: tensor.cuda().requires_grad_() for name, tensor in g.tensors()}
    render(Gaussians(**leaves), cam).sum().backward()
    expected = leaves["means"].grad.clone()
    with torch.cuda.stream(torch.cuda.Stream()):
        large = torch.zeros(4000, 4000, device="cuda")
        for _ in range(20):
            large = large @ large
        late = {name: (leaf.detach() + large[0, 0]).requires_grad_() for name, leaf in leaves.items()}
        image = render(Gaussians(**late), cam)
        for _ in range(20):
            large = large @ large
        (image * (1 + large[0, 0])).sum().backward()
    torch.cuda.synchronize()
    torch.testing.assert_close(late["means"].grad, expected, rtol=1e-3, atol=1e-4)


def test_the_low_pass_is_the_pixel_filter_by_default():
    g, cam = white_dot(4.0, 0.5), Camera(np.eye(4), 33, 33, 40.0, 40.0, 16.5, 16.5)
    assert torch.equal(render(g, cam), render(g, cam, 0.1))
    # A variance of 25 px^2 more halves the area's inverse and so the opacity.
    assert render(g, cam, 25.0)[16, 16, 0].item() == pytest.approx(0.25, rel=1e-5)


def test_other_devices_are_refused():
    g = Gaussians(**{name: tensor.to("meta") for name, tensor in gaussians(n=3).tensors()})
    with pytest.raises(ValueError, match="Gaussians on meta: must be on cpu or cuda"):
        render(g, camera())
    g.means = torch.zeros(3, 3)
    with pytest.raises(ValueError, match="Gaussians on cpu, meta: must be on one device"):
        render(g, camera())


def test_the_gradient_may_be_computed_in_another_thread(arrays):
    """As torch does on a card, in a thread that lives on while others go to later scopes of Dr.Jit."""
    found = []
    with ThreadPoolExecutor(1) as other:
        for apart in (True, False, True):
            leaves = leaves_of(gaussians(KINDS[0]), torch.float32)
            dr.detail.new_scope(dr.backend_v(arrays.plain.Float))
            backward = render_differentiable(arrays, Gaussians(**leaves), camera()).sum().backward
            other.submit(backward).result() if apart else backward()
            found.append({name: leaf.grad for name, leaf in leaves.items()})
    for name, own in found[1].items():
        assert all(torch.equal(gradients[name], own) for gradients in found), name


def test_an_image_cannot_be_differentiated_twice():
    leaves = leaves_of(gaussians(n=5))
    image = render(Gaussians(**leaves), camera())
    image.sum().backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="differentiated already: render it again"):
        image.sum().backward()
