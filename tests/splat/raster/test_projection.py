"""Projection against pinhole cameras and closed forms."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
import torch

from compose.camera.camera import Camera
from splat.raster.projection import NEAR, Splats, camera_numbers, distance, footprints, project, view_position
from tests.splat.raster import reference
from tests.splat.raster.splats import inverse_covariance, parameters_from
from tests.splat.samples import KINDS, camera, gaussians, white_dot


def numbers(splats, name: str) -> np.ndarray:
    """By name; of splats also the entries xx, xy, yy of the inverse of the 2D covariance."""
    if isinstance(splats, Splats) and name in ("xx", "xy", "yy"):
        return inverse_covariance(splats)[name]
    return dr.detach(getattr(splats, name), preserve_type=False).numpy()


def test_a_round_gaussian_on_the_axis_has_the_closed_form(arrays):
    """Standard deviation 0.5 at depth 4 with f 40 and 60: 5 and 7.5 px. A low-pass of 0.3 is added to 25 and
    56.25 px^2, and the opacity falls by the square root of the ratio of the determinants."""
    cam = Camera(np.eye(4), 33, 35, 40.0, 60.0, 16.5, 17.5)
    raw = footprints(parameters_from(arrays, white_dot(4.0, 0.5)), camera_numbers(arrays, cam))
    for name, value in (("x", 16.5), ("y", 17.5), ("xx", 25), ("xy", 0), ("yy", 56.25), ("depth", 4)):
        assert numbers(raw, name)[0] == pytest.approx(value, abs=1e-5), name
    assert numbers(raw, "conditional")[0] * numbers(raw, "yy")[0] == pytest.approx(25 * 56.25, rel=1e-5)
    splats = project(parameters_from(arrays, white_dot(4.0, 0.5)), camera_numbers(arrays, cam), 0.3)
    assert numbers(splats, "xx")[0] == pytest.approx(1 / 25.3, rel=1e-5)
    assert numbers(splats, "yy")[0] == pytest.approx(1 / 56.55, rel=1e-5)
    expected = 0.5 * np.sqrt(25 * 56.25 / (25.3 * 56.55))
    assert numbers(splats, "opacity")[0] == pytest.approx(expected, rel=1e-5)
    assert numbers(splats, "red")[0] == pytest.approx(1, rel=1e-5)


def test_a_gaussian_seen_edge_on_keeps_half_a_percent(arrays):
    """Without an extent along y its compensation would be 0; the floor is the root of 2.5e-5."""
    edge = white_dot(4.0, 0.5)
    edge.log_scales[1] = -20.0
    cam = Camera(np.eye(4), 33, 33, 40.0, 40.0, 16.5, 16.5)
    splats = project(parameters_from(arrays, edge), camera_numbers(arrays, cam), 0.1)
    assert numbers(splats, "opacity")[0] == pytest.approx(0.5 * 0.005, rel=1e-5)


def test_a_disc_on_a_wall_beside_the_viewer_is_outside_where_its_ellipsoid_is(arrays):
    """3.33 standard deviations around it miss the frame: seen from the frame's left border, of tangent -0.5,
    those of x + 0.5 z are 0.1 around -0.45. Linearized farther out, the disc would reach into the frame."""
    disc = white_dot(0.1, 0.2)
    disc.means[0], disc.log_scales[0] = -0.5, np.log(0.005)
    cam = Camera(np.eye(4), 40, 40, 40.0, 40.0, 20.0, 20.0)
    raw = footprints(parameters_from(arrays, disc), camera_numbers(arrays, cam))
    deviation = np.hypot(0.005, 0.5 * 0.2)
    assert numbers(raw, "x")[0] / np.sqrt(numbers(raw, "xx")[0]) == pytest.approx(-0.45 / deviation, rel=1e-4)
    assert numbers(raw, "x")[0] + 3.33 * np.sqrt(numbers(raw, "xx")[0]) < 0


def test_a_low_pass_may_differ_per_gaussian(arrays):
    g, cam = gaussians(n=2), camera()
    parameters, view = parameters_from(arrays, g), camera_numbers(arrays, cam)
    both = project(parameters, view, arrays.plain.Float([0.1, 30.0]))
    for k, low_pass in enumerate((0.1, 30.0)):
        alone = project(parameters, view, low_pass)
        for name in ("xx", "xy", "yy", "opacity"):
            assert numbers(both, name)[k] == numbers(alone, name)[k], name


@pytest.mark.parametrize("kind", KINDS)
def test_splats_equal_their_twin(arrays, kind):
    g, cam = gaussians(kind), camera()
    splats = project(parameters_from(arrays, g), camera_numbers(arrays, cam), 0.1)
    twin = reference.project(reference.double(g), cam, 0.1)
    seen = twin["depth"].numpy() > NEAR
    expected = {
        "x": twin["centre"][0],
        "y": twin["centre"][1],
        "xx": twin["inverse"][:, 0, 0],
        "xy": twin["inverse"][:, 0, 1],
        "yy": twin["inverse"][:, 1, 1],
        "red": twin["colour"][0],
        "green": twin["colour"][1],
        "blue": twin["colour"][2],
        "depth": twin["depth"],
    }
    for name, value in expected.items():
        # Worst seen 3e-4, of a Gaussian seen edge-on.
        np.testing.assert_allclose(numbers(splats, name)[seen], value.numpy()[seen], rtol=2e-3, atol=1e-4)
    np.testing.assert_allclose(numbers(splats, "opacity"), twin["opacity"].numpy(), rtol=1e-3, atol=1e-6)


def test_gaussians_nearer_than_the_near_plane_are_not_seen(arrays):
    cam = Camera(np.eye(4), 32, 32, 30.0, 30.0, 16.0, 16.0)
    for depth, seen in ((-1.0, False), (0.0, False), (0.9 * NEAR, False), (1.1 * NEAR, True), (1.0, True)):
        splats = project(parameters_from(arrays, white_dot(depth, 0.1)), camera_numbers(arrays, cam), 0.1)
        assert (numbers(splats, "opacity")[0] > 0) == seen, depth


def test_positions_are_those_of_the_camera(arrays):
    g, cam = gaussians("behind the camera", n=200), camera()
    means = [arrays.plain.Float(row) for row in g.means]
    seen, x, y, _ = view_position(means, camera_numbers(arrays, cam))
    expected, depth = cam.project(g.means.T.double().numpy())
    mask = depth > NEAR
    np.testing.assert_array_equal(seen.numpy(), mask)
    away = np.linalg.norm(g.means.T.double().numpy() - cam.position, axis=1)
    np.testing.assert_allclose(distance(means, camera_numbers(arrays, cam)).numpy(), away, rtol=1e-6)
    np.testing.assert_allclose(x.numpy()[mask], expected[mask, 0], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(y.numpy()[mask], expected[mask, 1], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("kind", ["overlap", "off-screen"])
def test_no_footprint_is_larger_than_the_bound(arrays, kind):
    """Pixels per unit of length, times the longest axis, bounds the footprint's standard deviation."""
    g, cam = gaussians(kind, n=300), camera()
    seen, _, _, spread = view_position(
        [arrays.plain.Float(row) for row in g.means], camera_numbers(arrays, cam)
    )
    raw = footprints(parameters_from(arrays, g), camera_numbers(arrays, cam))
    xx, xy, yy = (numbers(raw, name).astype(np.float64) for name in ("xx", "xy", "yy"))
    largest = np.sqrt((xx + yy) / 2 + np.sqrt(((xx - yy) / 2) ** 2 + xy**2))
    bound = spread.numpy() * torch.exp(g.log_scales.max(dim=0).values).numpy()
    mask = seen.numpy()
    assert mask.sum() > 100
    assert (largest[mask] <= bound[mask] * 1.0001).all()
    # It is a useful bound, too: a round Gaussian on the axis reaches it.
    axis = Camera(np.eye(4), 33, 33, 40.0, 40.0, 16.5, 16.5)
    dot = white_dot(4.0, 0.5)
    _, _, _, spread = view_position(
        [arrays.plain.Float(row) for row in dot.means], camera_numbers(arrays, axis)
    )
    assert spread.numpy()[0] * 0.5 == pytest.approx(5)


def test_cameras_share_kernels(arrays):
    """Numbers of the camera are read from memory: another camera compiles nothing."""
    g = gaussians(n=20, degree=0)
    run = lambda cam: dr.eval(project(parameters_from(arrays, g), camera_numbers(arrays, cam), 0.1).__dict__)  # noqa: E731
    run(camera())
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        run(camera(64, 20))
        run(Camera(np.eye(4), 33, 33, 40.0, 41.0, 16.5, 16.0))
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert len(kernels) >= 2
    assert all(k["cache_hit"] for k in kernels)
