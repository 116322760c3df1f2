"""Gaussians, cameras and frames at the ends of what float32 and users allow, against the float64 twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from compose.camera.camera import Camera
from splat.model.gaussians import SH_DC, Gaussians, concatenated
from splat.raster.differentiable import render_differentiable
from splat.raster.projection import LARGEST_RADIANCE, camera_numbers, project
from splat.raster.tiles import TileGrid
from tests.extremes import extreme
from tests.splat.raster import reference
from tests.splat.raster.splats import bin_splats, parameters_from
from tests.splat.samples import leaves_of

# (w, x, y, z): 45 degrees about the view axis, and askew to all axes.
DIAGONAL = (np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8))
ASKEW = (0.9, 0.2, 0.3, 0.4)


def one(mean=(0.0, 0.0, 4.0), log_scale=-1.2, rotation=(1, 0, 0, 0), logit=1.0, sh=0.5 / SH_DC):
    """One Gaussian; a single number stands for all axes, or all channels."""
    column = lambda values, count: torch.tensor(np.broadcast_to(values, count).copy()).float()[:, None]  # noqa: E731
    return Gaussians(
        column(mean, 3), column(log_scale, 3), column(rotation, 4), column(logit, 1)[0], column(sh, 3)[None]
    )


# Lies half beside `one` and behind it.
OTHER = one(mean=(0.2, 0.1, 5.0), logit=0.3, sh=1.0)


def with_other(**parameters) -> Gaussians:
    """One Gaussian and an ordinary one behind it."""
    return concatenated([one(**parameters), OTHER])


def view(width: int = 48, height: int = 40, focal: float = 50.0) -> Camera:
    """Looks along +z from the origin, a little off-centre."""
    return Camera(np.eye(4), width, height, focal, 1.1 * focal, width / 2 + 0.3, height / 2 - 0.2)


def smooth_weight(camera: Camera) -> torch.Tensor:
    """(H, W, 3) float64 derivative of a loss by the image."""
    x, y = torch.meshgrid(torch.arange(camera.width), torch.arange(camera.height), indexing="xy")
    return torch.stack([torch.sin(x / 9.0), torch.cos(y / 7.0), torch.sin((x + y) / 11.0)], dim=-1).double()


def rendered(arrays, g: Gaussians, camera: Camera, low_pass: float = 0.1):
    """Image, and gradient of its sum under `smooth_weight` by every tensor."""
    leaves = leaves_of(g)
    image = render_differentiable(arrays, Gaussians(**leaves), camera, low_pass)
    (image * smooth_weight(camera).float()).sum().backward()
    return image.detach().double(), {name: leaf.grad.double() for name, leaf in leaves.items()}


def worst_error(image: torch.Tensor, g: Gaussians, camera: Camera, low_pass: float = 0.1) -> float:
    """Of an image against the twin's, relative to the brightest pixel where that is above 1."""
    # Beyond e^60 nothing changes any more but that squares leave the range of float64, too.
    g = replace(g, log_scales=g.log_scales.clamp(max=60))
    expected = reference.render(reference.double(g), camera, low_pass)
    return float((image - expected).abs().max() / expected.max().clamp(min=1))


def differences(g: Gaussians, camera: Camera, low_pass: float, only: list[str]) -> dict[str, torch.Tensor]:
    """Finite differences of the twin in float64; steps so small that hardly a pixel crosses 1/255."""
    weight, double, found = smooth_weight(camera), dict(reference.double(g).tensors()), {}
    for name in only:
        slopes = []
        for k in range(double[name].numel()):
            values = []
            for step in (-2e-8, 2e-8):
                moved = {key: tensor.clone() for key, tensor in double.items()}
                moved[name].view(-1)[k] += step
                image = reference.render(Gaussians(**moved), camera, low_pass)
                values.append((image * weight).sum().item())
            slopes.append((values[1] - values[0]) / 4e-8)
        found[name] = torch.tensor(slopes).reshape(double[name].shape)
    return found


SHAPES = {
    "scale 1e-8": ({"log_scale": np.log(1e-8)}, view(), 0.1),
    "scale 1e8": ({"log_scale": np.log(1e8)}, view(), 0.1),
    "scale e^200": ({"log_scale": 200.0}, view(), 0.1),
    "scale e^-200": ({"log_scale": -200.0}, view(), 0.1),
    "scale e^-200 without a filter": ({"log_scale": -200.0}, view(), 0.0),
    "one axis e^-50, seen askew": ({"log_scale": [-1, -1, -50], "rotation": ASKEW}, view(), 0.1),
    "one axis e^-50, seen edge-on": ({"log_scale": [-1, -50, -1]}, view(), 0.1),
    "needle of 500 px at 45 degrees": (
        {"log_scale": np.log([2, 1e-4, 1e-4]), "rotation": DIAGONAL},
        view(256, 256, 1e3),
        0.1,
    ),
    "needle of 2,500,000 px at 45 degrees": (
        {"log_scale": np.log([1e4, 1e-4, 1e-4]), "rotation": DIAGONAL},
        view(256, 256, 1e3),
        0.1,
    ),
    "needle of aspect 1e6, askew": (
        {"log_scale": np.log([100, 1e-4, 1e-4]), "rotation": ASKEW, "logit": 2.0},
        view(256, 256, 1e3),
        0.1,
    ),
    "needle of aspect 1e6, nearly level": (
        {"log_scale": np.log([100, 1e-4, 1e-4]), "rotation": (1, 0, 0, 0.01)},
        view(256, 256, 1e3),
        0.1,
    ),
    "needle of aspect 1e6, nearly upright": (
        {"log_scale": np.log([1e-4, 100, 1e-4]), "rotation": (1, 0, 0, 0.01)},
        view(256, 256, 1e3),
        0.1,
    ),
    "at the camera": ({"mean": (0, 0, 0)}, view(), 0.1),
    "on the near plane": ({"mean": (1e-4, 2e-4, 0.0101), "log_scale": np.log(1e-3)}, view(), 0.1),
    "on the near plane and large": ({"mean": (1e-4, 2e-4, 0.0101)}, view(), 0.1),
    "just behind the near plane": ({"mean": (0, 0, 0.0099)}, view(), 0.1),
    "just behind the camera": ({"mean": (0, 0, -1e-6)}, view(), 0.1),
    "covers the whole frame": ({"log_scale": 3.0, "logit": 8.0}, view(), 0.1),
    "at a grazing angle": ({"mean": (1.25, 1, 2), "log_scale": np.log(0.5)}, view(), 0.1),
    "logit -200": ({"logit": -200.0}, view(), 0.1),
    "logit 200": ({"logit": 200.0}, view(), 0.1),
    "opacity just above 1/255": ({"logit": np.log(1.05 / 254)}, view(), 0.1),
    "opacity just below 1/255": ({"logit": np.log(0.95 / 254)}, view(), 0.1),
    "quaternion of length 1e-20": (
        {"log_scale": np.log([0.3, 0.1, 0.2]), "rotation": 1e-20 * np.array(ASKEW)},
        view(),
        0.1,
    ),
    "quaternion of length 1e20": (
        {"log_scale": np.log([0.3, 0.1, 0.2]), "rotation": 1e20 * np.array(ASKEW)},
        view(),
        0.1,
    ),
    "sh 0": ({"sh": 0.0}, view(), 0.1),
    "sh 1e4": ({"sh": 1e4}, view(), 0.1),
    "sh -1e17": ({"sh": -1e17}, view(), 0.1),
    "low-pass 0": ({"log_scale": np.log(0.05)}, view(), 0.0),
    "low-pass 1e4 px^2": ({"log_scale": 2.0, "logit": 4.0}, view(), 1e4),
    "low-pass 1e30 px^2": ({"log_scale": 2.0, "logit": 4.0}, view(), 1e30),
    "mean at 1e30": ({"mean": (1e30, 1e30, 1e30)}, view(), 0.1),
    "field of view of 0.1 degrees": (
        {"mean": (4e-4, 3e-4, 4), "log_scale": np.log([4e-4, 6e-4, 8e-4])},
        view(focal=27_500),
        0.1,
    ),
    "field of view of 179 degrees": (
        {"mean": (30, 20, 1), "log_scale": np.log([9, 6, 0.5])},
        view(focal=0.209),
        0.1,
    ),
    "frame of 1 x 1": ({}, view(1, 1, 2.0), 0.1),
    "frame of 1 x 4096": ({"log_scale": 2.0}, view(1, 4096, 500.0), 0.1),
    "frame of 4096 x 1": ({"log_scale": 2.0}, view(4096, 1, 500.0), 0.1),
}


def row(name: str):
    return pytest.param(
        *SHAPES[name],
        id=name,
        marks=extreme(
            f"splat: {name}",
            given="one Gaussian before an ordinary one",
            expected="image within 3e-5 of float64, gradients finite",
        ),
    )


@pytest.mark.parametrize(("parameters", "camera", "low_pass"), [row(name) for name in SHAPES])
def test_images_equal_the_twins_and_gradients_are_finite(each_arrays, got, parameters, camera, low_pass):
    g = with_other(**parameters)
    image, gradients = rendered(each_arrays, g, camera, low_pass)
    assert got(worst_error(image, g, camera, low_pass), ".1e") < 3e-5
    assert all(torch.isfinite(gradient).all() for gradient in gradients.values())


SLOPES = {
    "an ordinary Gaussian": ({"rotation": ASKEW, "log_scale": np.log([0.3, 0.1, 0.2])}, view(), 0.1),
    "opacity near 0.99": ({"logit": np.log(0.992 / 0.008)}, view(), 0.1),
    "opacity near 1/255": ({"logit": np.log(1.3 / 254)}, view(), 0.1),
    "a needle of 4,000 px": (
        {"log_scale": np.log([16, 1e-4, 1e-4]), "rotation": DIAGONAL},
        view(128, 128, 1e3),
        0.1,
    ),
    "a needle of aspect 1e6": (
        {"log_scale": np.log([100, 1e-4, 1e-4]), "rotation": ASKEW},
        view(128, 128, 1e3),
        0.1,
    ),
    "a flat Gaussian": ({"log_scale": [-1, -1, -50], "rotation": ASKEW}, view(), 0.1),
    "a huge Gaussian": ({"log_scale": np.log([1e3, 2e3, 3e3]), "rotation": ASKEW}, view(), 0.1),
    "a Gaussian of scale 1e8": ({"log_scale": np.log(1e8)}, view(), 0.1),
    "a tiny Gaussian": ({"log_scale": np.log([1e-2, 2e-2, 3e-2]), "rotation": ASKEW}, view(), 0.1),
    "a Gaussian at the near plane": (
        {"mean": (1e-4, 2e-4, 0.0101), "log_scale": np.log([1e-3, 2e-3, 5e-4]), "rotation": ASKEW},
        view(),
        0.1,
    ),
    "a grazing Gaussian inside the clamp": (
        {"mean": (1.2, 1, 2), "log_scale": np.log([0.5, 0.3, 0.4]), "rotation": ASKEW},
        view(),
        0.1,
    ),
    "a grazing Gaussian beyond the clamp": (
        {"mean": (1.3, 1.1, 2), "log_scale": np.log([0.5, 0.6, 0.7]), "rotation": ASKEW},
        view(),
        0.1,
    ),
    "no low-pass": ({"rotation": ASKEW, "log_scale": np.log([0.1, 0.04, 0.06])}, view(), 0.0),
}


@pytest.mark.parametrize(
    ("parameters", "camera", "low_pass"),
    [
        pytest.param(
            *case,
            id=name,
            marks=extreme(
                f"gradient of {name}",
                given="every parameter",
                expected="within 5e-4 of float64 finite differences",
            ),
        )
        for name, case in SLOPES.items()
    ],
)
def test_gradients_equal_finite_differences(each_arrays, got, parameters, camera, low_pass):
    g = with_other(**parameters)
    _, gradients = rendered(each_arrays, g, camera, low_pass)
    expected = differences(g, camera, low_pass, list(gradients))
    worst = 0.0
    for name, slope in expected.items():
        # Relative to the largest of both Gaussians; where that is nothing, to 1.
        scale = slope.abs().max().clamp(min=1)
        worst = max(worst, float((gradients[name] - slope).abs().max() / scale))
    assert got(worst, ".1e") < 5e-4


def as_none(kind: str, value: float):
    """A row of a Gaussian that must not be drawn."""
    row = extreme(
        f"{value} in a Gaussian's {kind}",
        given="one such Gaussian before an ordinary one",
        expected="image and gradients of the other as without it",
    )
    return pytest.param(kind, value, marks=row)


def as_limit(kind: str):
    """A row of a Gaussian that is drawn like one of large numbers."""
    row = extreme(
        f"inf in a Gaussian's {kind}",
        given="one such Gaussian before an ordinary one",
        expected="the image of 1e30 instead, and finite gradients of the other",
    )
    return pytest.param(kind, marks=row)


KINDS = ["means", "log_scales", "rotations", "opacity_logits", "sh"]


@pytest.mark.parametrize(
    ("kind", "value"),
    [as_none(kind, np.nan) for kind in KINDS] + [as_none(kind, np.inf) for kind in ("means", "rotations")],
)
def test_a_number_that_is_none_touches_no_pixel(each_arrays, got, kind, value):
    bad = one()
    getattr(bad, kind).view(-1)[0] = value
    image, gradients = rendered(each_arrays, concatenated([bad, OTHER]), view())
    without, expected = rendered(each_arrays, OTHER, view())
    assert got(float((image - without).abs().max()), "g") == 0
    for name, gradient in gradients.items():
        assert torch.equal(gradient[..., 1:], expected[name]), name


@pytest.mark.parametrize("kind", [as_limit(kind) for kind in ("log_scales", "opacity_logits", "sh")])
def test_an_infinite_number_is_drawn_as_a_large_one(each_arrays, got, kind):
    images = []
    for value in (np.inf, 1e30):
        large = one()
        getattr(large, kind).view(-1)[0] = value
        image, gradients = rendered(each_arrays, concatenated([large, OTHER]), view())
        assert all(torch.isfinite(gradient[..., 1:]).all() for gradient in gradients.values())
        images.append(image)
    assert got(float((images[0] - images[1]).abs().max()), "g") == 0


@pytest.mark.parametrize(
    "sh",
    [
        pytest.param(
            sh,
            marks=extreme(
                f"sh {sh:g}",
                given="one small Gaussian of that coefficient before an ordinary one",
                expected="radiance of at most 1e12, all finite, pixels beside it as without it",
            ),
        )
        for sh in (1e8, 1e17, 1e38, 3.4e38)
    ],
)
def test_a_blinding_splat_spoils_only_what_it_covers(each_arrays, got, sh):
    camera, blinding = view(64, 40), one(mean=(-0.9, 0, 4), log_scale=np.log(0.05), sh=sh)
    image, gradients = rendered(each_arrays, concatenated([blinding, OTHER]), camera)
    without, expected = rendered(each_arrays, OTHER, camera)
    assert got(float(image.max()), ".2e") <= LARGEST_RADIANCE
    assert image.max() > 0.3 * LARGEST_RADIANCE
    # It covers a part of the left half, and nothing of the other Gaussian.
    assert torch.equal(image[:, 32:], without[:, 32:])
    for name, gradient in gradients.items():
        assert torch.isfinite(gradient).all(), name
        assert torch.equal(gradient[..., 1:], expected[name]), name


@extreme(
    "quaternion of length 0",
    given="one such Gaussian before an ordinary one",
    expected="drawn without a rotation, gradients finite",
)
def test_a_quaternion_of_no_length_does_not_turn(each_arrays, got):
    shape = {"log_scale": np.log([0.3, 0.1, 0.2])}
    image, gradients = rendered(each_arrays, with_other(rotation=(0, 0, 0, 0), **shape), view())
    assert got(worst_error(image, with_other(**shape), view()), ".1e") < 1e-5
    assert all(torch.isfinite(gradient).all() for gradient in gradients.values())


@pytest.mark.parametrize("low_pass", [-0.1, float("nan"), float("inf")])
def test_filters_of_no_width_are_refused(each_arrays, low_pass):
    with pytest.raises(ValueError, match=r"low-pass of .* px\^2: must be finite and not negative"):
        render_differentiable(each_arrays, OTHER, view(), low_pass)


@extreme(
    "squared error of blinding splats",
    given="sh 1e38 over the whole frame, loss = sum of the squared image",
    expected="finite gradients",
)
def test_a_squared_error_of_the_brightest_radiance_has_finite_gradients(each_arrays, got):
    leaves = leaves_of(with_other(log_scale=3.0, logit=9.0, sh=1e38))
    render_differentiable(each_arrays, Gaussians(**leaves), view()).square().sum().backward()
    gradients = torch.cat([leaf.grad.reshape(-1) for leaf in leaves.values()])
    got(float(gradients.abs().max()), ".1e")
    assert torch.isfinite(gradients).all()


@pytest.mark.parametrize(
    "deviation",
    [
        pytest.param(
            deviation,
            marks=extreme(
                f"extent of a needle of {deviation:,} px",
                given="45 degrees, 0.3 px across, a frame of 20,480 x 20,480",
                expected="the outermost of its tiles within one tile of float64's",
            ),
        )
        for deviation in (500, 2000, 4000)
    ],
)
def test_a_needle_keeps_its_extent(each_arrays, got, deviation):
    side = 20_480
    camera = Camera(np.eye(4), side, side, 1e3, 1e3, side / 2, side / 2)
    needle = one(log_scale=np.log([deviation / 250, 1e-4, 1e-4]), rotation=DIAGONAL, logit=3.0)
    projected = project(parameters_from(each_arrays, needle), camera_numbers(each_arrays, camera), 0.1)
    bins = bin_splats(each_arrays, projected, TileGrid(side, side))
    start, end = bins.lists.ranges.numpy().reshape(-1, 2)[:-1].T
    columns = bins.tiles.numpy()[end > start] % bins.grid.columns
    splats = reference.project(reference.double(needle), camera, 0.1)
    level = 2 * np.log(255 * float(splats["opacity"][0]))
    # The covariance's diagonal, as half of it lies along each axis.
    reach = np.sqrt(level * (deviation**2 + 0.025**2) / 2)
    found = (columns.max() + 1 - columns.min()) * 16 / 2
    assert got(found / reach, ".4f") == pytest.approx(1, abs=17 / reach)


@pytest.mark.parametrize(
    ("focal", "low_pass"),
    [
        pytest.param(
            *case,
            marks=extreme(
                f"magnitudes at random, focal length {case[0]:g} px, low-pass {case[1]:g} px^2",
                given="400 Gaussians, 3 in 10 numbers of any magnitude that float32 holds",
                expected="image and gradients finite",
            ),
        )
        for case in ((50.0, 0.1), (0.1, 0.0), (1e6, 1e20))
    ],
)
def test_numbers_of_any_magnitude_stay_finite(each_arrays, got, focal, low_pass):
    rng, n = np.random.default_rng(11), 400

    def mixed(ordinary: np.ndarray, low: float, high: float) -> torch.Tensor:
        """Numbers of which 3 in 10 have any magnitude from 10^low to 10^high, and either sign."""
        shape = ordinary.shape
        wild = rng.choice([-1, 1], shape) * 10.0 ** rng.uniform(low, high, shape)
        return torch.tensor(np.where(rng.random(shape) < 0.3, wild, ordinary)).float()

    g = Gaussians(
        mixed(rng.normal(size=(3, n)) + np.array([[0], [0], [4]]), -38, 38),
        mixed(rng.normal(size=(3, n)) - 2, -3, 3),
        mixed(rng.normal(size=(4, n)), -38, 38),
        mixed(rng.normal(size=n), -2, 4),
        # Larger coefficients of directions have derivatives beyond float32.
        mixed(rng.normal(size=(4, 3, n)) * 0.3, -38, 30),
    )
    image, gradients = rendered(each_arrays, g, view(focal=focal), low_pass)
    assert torch.isfinite(image).all()
    assert image.max() > 0
    for name, gradient in gradients.items():
        assert torch.isfinite(gradient).all(), name
    got(f"all finite, radiance up to {float(image.max()):.1e}")


@extreme(
    "1,000 coincident splats", given="the same Gaussian 1,000 times", expected="as in float64, within 1e-4"
)
def test_coincident_gaussians_blend_as_one_after_another(each_arrays, got):
    """The block stops where 1e-4 of the light is left."""
    g = concatenated([one(logit=-4.0)] * 1000)
    image, gradients = rendered(each_arrays, g, view())
    assert got(worst_error(image, g, view()), ".1e") < 1e-4
    assert all(torch.isfinite(gradient).all() for gradient in gradients.values())


@extreme(
    "depths that tie",
    given="red, green and blue at one depth, in both orders",
    expected="the order of their indices, as in float64",
)
def test_splats_of_one_depth_keep_their_order(each_arrays, got):
    colours = [one(sh=np.roll([1.5, -1.5, -1.5], k)) for k in range(3)]
    for g in (concatenated(colours), concatenated(colours[::-1])):
        image, _ = rendered(each_arrays, g, view())
        assert got(worst_error(image, g, view()), ".1e") < 3e-5


@extreme("100,000 splats in a tile", given="a frame of 16 x 16", expected="as in float64, within 1e-3")
def test_a_hundred_thousand_splats_share_a_tile(each_arrays, got):
    generator, n = torch.Generator().manual_seed(3), 100_000
    means = torch.randn(3, n, generator=generator) * 0.2 + torch.tensor([[0.0], [0], [4]])
    g = Gaussians(
        means,
        torch.full((3, n), -2.5),
        torch.randn(4, n, generator=generator),
        torch.full((n,), -5.0),
        torch.rand(1, 3, n, generator=generator),
    )
    camera = view(16, 16, 20.0)
    image, gradients = rendered(each_arrays, g, camera)
    assert got(float((image[8, ::3] - blended_at_once(g, camera, 8)[::3]).abs().max()), ".1e") < 1e-3
    assert all(torch.isfinite(gradient).all() for gradient in gradients.values())


def blended_at_once(g: Gaussians, camera: Camera, row: int) -> torch.Tensor:
    """(W, 3) one row of the twin's image, all Gaussians in one cumulative product."""
    splats = reference.project(reference.double(g), camera, 0.1)
    order = torch.argsort(splats["depth"])
    x, y = (splats["centre"][k, order] for k in (0, 1))
    dx, dy = torch.arange(camera.width)[:, None] + 0.5 - x, row + 0.5 - y  # (W, N)
    inverse, colour = splats["inverse"][order], splats["colour"][:, order]
    q = inverse[:, 0, 0] * dx**2 + 2 * inverse[:, 0, 1] * dx * dy + inverse[:, 1, 1] * dy**2
    alpha = (splats["opacity"][order] * torch.exp(-q / 2)).clamp(max=0.99)
    alpha = alpha * (alpha >= 1 / 255)
    before = torch.cumprod(1 - alpha, dim=1) / (1 - alpha)
    return (alpha * before) @ colour.T


@pytest.mark.parametrize(
    ("offset", "focal"),
    [
        pytest.param(
            *case,
            marks=extreme(
                name, given="a turned camera, Gaussians at a distance of 4", expected="within 1e-5 of float64"
            ),
        )
        for name, case in {
            "a scene a million units from the origin": (1e6, 50.0),
            "0.1 degrees over 4,096 pixels": (0.0, 2.35e6),
        }.items()
    ],
)
def test_positions_keep_their_place(each_arrays, got, offset, focal):
    """The Gaussians are where float32 puts them; where they are seen must not depend on where they lie."""
    turn = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()
    eye, size = np.array([0.0123, -0.3, 0.2]) + offset, 4 / focal
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = turn, -turn @ eye
    camera = Camera(world_to_camera, 64, 64, focal, focal, 32, 32)
    places = [eye + turn.T @ [x * size, -x * size, 4] for x in (-12, 0, 9)]
    g = concatenated(
        [one(mean=place, log_scale=np.log(size * np.array([6, 1, 3])), rotation=ASKEW) for place in places]
    )
    image, _ = rendered(each_arrays, g, camera)
    assert image.max() > 0.5
    assert got(worst_error(image, g, camera), ".1e") < 1e-5


@extreme(
    "order at depths of 1e8",
    given="red before green at 1e8 and 1.001e8 units, listed the other way round",
    expected="as in float64, within 1e-4",
)
def test_far_splats_keep_their_order(each_arrays, got):
    g = concatenated(
        [
            one(mean=(0, 0, depth), log_scale=np.log(1e7), sh=sh)
            for depth, sh in ((1.001e8, (-2.0, 1.5, -2)), (1e8, (1.5, -2.0, -2)))
        ]
    )
    image, _ = rendered(each_arrays, g, view())
    assert got(worst_error(image, g, view()), ".1e") < 1e-4


@extreme("frame of 4096 x 4096", given="two Gaussians", expected="the pixels around one as in a small frame")
def test_a_frame_of_4096_by_4096(each_arrays, got):
    small, large = view(), view(4096, 4096)
    image = render_differentiable(each_arrays, with_other(), large)
    left, top = (round(a - b) for a, b in ((large.cx, small.cx), (large.cy, small.cy)))
    crop = image[top : top + small.height, left : left + small.width]
    assert got(worst_error(crop.double(), with_other(), small), ".1e") < 3e-4
