"""Gaussians that are blended display-encoded, against the float64 twin of 3D Gaussian splatting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.camera import Camera, camera_from_pose, look_at
from compose.image.colour import srgb_from_radiance
from splat.io.ply import load_ply
from splat.model.gaussians import SH_DC, Blending, Gaussians, perceptual_from_radiance
from splat.model.points import rows_of
from splat.raster.differentiable import render_differentiable
from tests.conftest import real_file
from tests.splat.raster.plain_3dgs import picture
from tests.splat.samples import KINDS, gaussians, leaves_of, white_dot


def centred(width: int = 48, height: int = 40) -> Camera:
    pose = look_at(np.array([-0.8, 0.1, -4.0]), np.zeros(3), np.array([0.1, -1.0, 0.0]))
    return camera_from_pose(pose, width, height, 45.0, 48.0, width / 2, height / 2)


def shown(g: Gaussians) -> Gaussians:
    return replace(g, blending=Blending.DISPLAY)


def encoded(arrays, g: Gaussians, view: Camera, low_pass: float = 0.1) -> torch.Tensor:
    """(H, W, 3) what is blended, before it becomes radiance."""
    return perceptual_from_radiance(render_differentiable(arrays, shown(g), view, low_pass))


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_are_those_of_3d_gaussian_splatting(each_arrays, kind):
    g = gaussians(kind)
    # Lights brighter than a display, and colours that would be negative, are among them.
    g.sh[0] = 10 * g.sh[0] - 6
    expected = picture(g, centred()).numpy()
    assert expected.max() > 1
    np.testing.assert_allclose(encoded(each_arrays, g, centred()), expected, atol=2e-3)


def test_a_picture_is_what_a_display_shows_of_radiance(arrays):
    image = render_differentiable(arrays, shown(gaussians()), centred()).numpy()
    expected = picture(gaussians(), centred()).clamp(0, 1)
    np.testing.assert_allclose(srgb_from_radiance(image), expected, atol=2e-3)


def test_a_black_and_a_white_half_are_blended_to_the_middle_of_the_display(arrays):
    """Half of white over nothing is 0.5 encoded, 0.214 linear; linear blending gives half the radiance."""
    view = camera_from_pose(np.eye(4), 9, 9, 9.0, 9.0, 4.5, 4.5)
    dot = white_dot(4.0, 2.0)
    assert render_differentiable(arrays, shown(dot), view)[4, 4, 0] == pytest.approx(0.2140, abs=1e-3)
    assert render_differentiable(arrays, dot, view)[4, 4, 0] == pytest.approx(0.5, abs=1e-2)


def test_a_tiny_gaussian_is_dilated_and_stays_opaque(arrays):
    """A point at the centre of a pixel: 0.8 there, and 0.8 exp(-1 / 0.6) = 0.151 beside it."""
    view = camera_from_pose(np.eye(4), 9, 9, 9.0, 9.0, 4.5, 4.5)
    row = encoded(arrays, white_dot(4.0, 1e-4, 0.8), view)[4, :, 0]
    np.testing.assert_allclose(row[3:6], [0.1511, 0.8, 0.1511], atol=1e-3)


def test_a_wider_filter_keeps_the_light_beyond_the_dilation(arrays):
    """Of a point with 1.2 px^2, the peak is 0.3 / 1.2 of what the dilation alone leaves."""
    view = camera_from_pose(np.eye(4), 9, 9, 9.0, 9.0, 4.5, 4.5)
    peaks = [
        float(encoded(arrays, white_dot(4.0, 1e-4, 0.8), view, low_pass)[4, 4, 0]) for low_pass in (0.3, 1.2)
    ]
    assert peaks == pytest.approx([0.8, 0.2], abs=1e-3)


@pytest.mark.parametrize("kind", ["overlap", "nearly flat"])
def test_gradients_equal_the_twins(each_arrays, kind):
    torch.manual_seed(1)
    weight = torch.rand(40, 48, 3)
    own, plain = leaves_of(gaussians(kind, 20)), leaves_of(gaussians(kind, 20), torch.float64)
    (encoded(each_arrays, Gaussians(**own), centred()) * weight).sum().backward()
    (picture(Gaussians(**plain), centred()) * weight).sum().backward()
    for name, leaf in plain.items():
        largest = float(leaf.grad.abs().max())
        np.testing.assert_allclose(own[name].grad, leaf.grad, atol=3e-3 * largest, err_msg=name)


@pytest.mark.parametrize("name", ["sh", "opacity_logits", "log_scales"])
def test_the_gradient_of_radiance_equals_finite_differences(arrays, name):
    """In float64, by the twin and the curve after it: 3 numbers of one Gaussian among others."""
    g, step = gaussians("overlap", 12, degree=1), 1e-5
    leaves = leaves_of(g)
    render_differentiable(arrays, shown(Gaussians(**leaves)), centred(24, 20)).sum().backward()

    def total(k: int, moved: float) -> float:
        values = {n: t.double().clone() for n, t in g.tensors()}
        values[name].view(-1)[k] += moved
        value = picture(Gaussians(**values), centred(24, 20))
        bright = ((value.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4
        return float(torch.where(value <= 0.04045, value / 12.92, bright).sum())

    found = leaves[name].grad.view(-1)
    for k in (0, 5, 11):
        expected = (total(k, step) - total(k, -step)) / (2 * step)
        assert found[k] == pytest.approx(expected, rel=1e-2, abs=2e-3)


def test_a_colour_below_black_has_no_gradient_and_no_light(arrays):
    dot = white_dot(4.0, 2.0)
    dot.sh[:] = -0.6 / SH_DC
    dot.sh.requires_grad_()
    view = camera_from_pose(np.eye(4), 9, 9, 9.0, 9.0, 4.5, 4.5)
    image = render_differentiable(arrays, shown(dot), view)
    image.sum().backward()
    assert not image.any()
    assert not dot.sh.grad.any()


def test_a_real_file_looks_as_its_trainer_shows_it(arrays):
    g = load_ply(real_file("splats/kacytran_try_it7000.ply"))
    means = rows_of(g.means)
    middle = np.median(means, axis=0)
    size = np.median(np.linalg.norm(means - middle, axis=1))
    for away in ([0, 0, -3], [2.5, 0.5, 1.5], [0.3, 0, 0.3]):
        pose = look_at(middle + size * np.array(away), middle, np.array([0, -1.0, 0]))
        view = camera_from_pose(pose, 160, 120, 140.0, 140.0, 80.0, 60.0)
        found = srgb_from_radiance(render_differentiable(arrays, g, view).numpy())[::7, ::7]
        error = found - picture(g, view, 7).clamp(0, 1).numpy()
        assert -10 * np.log10(np.square(error).mean()) > 60
