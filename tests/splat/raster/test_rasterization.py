"""`splat.rasterization` against hand-computed pixels, its float64 twin, finite differences and gsplat."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from splat.raster.rasterization import rasterization
from tests.conftest import real_file
from tests.extremes import extreme
from tests.splat.raster import rasterization_twin as twin
from tests.splat.raster.rasterization_twin import Options, sample

# Options, channels and number of Gaussians.
CASES = {
    "RGB": (Options(26, 19), (3,), 5),
    "1 channel, expected depth only": (Options(26, 19, render_mode="ED"), (1,), 5),
    "7 channels and depth, antialiased": (
        Options(26, 19, render_mode="RGB+D", rasterize_mode="antialiased"),
        (7,),
        4,
    ),
    "harmonics and expected depth": (Options(26, 19, render_mode="RGB+ED", sh_degree=3), (16, 3), 2),
    "2 channels, another filter": (Options(26, 19, eps2d=1.5, near_plane=2.8, far_plane=3.4), (2,), 5),
}


@pytest.fixture(params=CASES)
def case(request) -> tuple[Options, dict[str, np.ndarray]]:
    """Options, and Gaussians in front of two cameras, with backgrounds."""
    options, channels, count = CASES[request.param]
    behind = np.random.default_rng(3).uniform(size=(2, channels[-1]))
    return options, sample(count, 2, channels) | {"backgrounds": behind}


@pytest.fixture
def device(each_arrays) -> torch.device:
    return each_arrays.device


def leaves(v: dict[str, np.ndarray], device: torch.device) -> dict[str, torch.Tensor]:
    """The inputs for the rasterizer: float32 tensors that torch differentiates by."""
    return {k: torch.tensor(x, dtype=torch.float32, device=device).requires_grad_() for k, x in v.items()}


def assert_close(found: torch.Tensor, expected: np.ndarray, tolerance: float) -> None:
    """Agreement relative to the largest number."""
    assert found.shape == expected.shape
    error = np.abs(found.detach().cpu().double().numpy() - expected).max()
    assert error <= tolerance * max(np.abs(expected).max(), 1e-9), error


def test_images_equal_the_twins(case, device):
    options, v = case
    images = rasterization(**leaves(v, device), **vars(options))[:2]
    # Worst seen: 2e-5 where a depth is divided by an opacity of 1/255, otherwise 1e-6.
    for found, expected in zip(images, twin.render(v, options), strict=True):
        assert_close(found, expected, 1e-4)


def test_gradients_equal_finite_differences(case, device):
    """By every number of every input, from a loss of both images."""
    options, v = case
    inputs = leaves(v, device)
    image, opacity, meta = rasterization(**inputs, **vars(options), packed=False)
    meta["means2d"].retain_grad()
    rng = np.random.default_rng(5)
    by_image, by_opacity = (rng.normal(size=value.shape) for value in (image, opacity))
    weights = [torch.tensor(by, device=device) for by in (by_image, by_opacity)]
    ((image * weights[0]).sum() + (opacity * weights[1]).sum()).backward()
    for name, leaf in inputs.items():
        expected = twin.slopes(v, name, options, by_image, by_opacity)
        if leaf.grad is None:
            assert not expected.any(), name
        else:
            assert_close(leaf.grad, expected, 5e-4)
    moved = v | {"offsets": np.zeros((2, len(v["means"]), 2))}
    assert_close(meta["means2d"].grad, twin.slopes(moved, "offsets", options, by_image, by_opacity), 5e-4)


def test_absolute_gradients_are_summed_over_pixels(device):
    """Of differences, pixel by pixel."""
    options, v = Options(26, 19), sample(4, 2)
    image, _, meta = rasterization(**leaves(v, device), **vars(options), packed=False, absgrad=True)
    weights = np.random.default_rng(5).normal(size=image.shape)
    (image * torch.tensor(weights, device=device)).sum().backward()
    expected, step = np.zeros((2, 4, 2)), 1e-6
    for index in np.ndindex(expected.shape):
        moved = np.zeros(expected.shape)
        moved[index] = step
        up, down = (twin.render(v | {"offsets": sign * moved}, options)[0] for sign in (1, -1))
        expected[index] = np.abs((weights * (up - down)).sum(axis=-1)).sum() / (2 * step)
    assert_close(meta["means2d"].absgrad, expected, 5e-4)


@pytest.mark.parametrize("aside", [-0.05, -0.2])
def test_opaque_ones_and_those_beside_the_frame_equal_the_twins(device, aside):
    """Alphas are cut, pixels end, and projections are linearized at the limit on each side of the frame."""
    options, v = Options(26, 19), sample(8, 1)
    # The first one is in front of the second, which is as wide as the frame, and the third one behind both.
    v["opacities"][:3] = 0.96, 1, 0.9
    v["means"][:3] = [[aside, 0, -0.8], [0, 0, 0], [-0.1, 0.1, 0.8]]
    v["scales"][:3] = [[0.3], [3], [0.3]]
    v["viewmats"][0, :3, :3] = np.eye(3)
    v["scales"][4:] *= 4
    v["means"][4:] = [[2.9, 0.1, -0.2], [-2.7, 0, 0.3], [0.2, 2.2, -0.1], [0, -2.1, 0.4]]
    inputs = leaves(v, device)
    image, _, _ = rasterization(**inputs, **vars(options))
    expected, expected_opacity = twin.render(v, options)
    assert expected_opacity.max() > 0.999
    assert_close(image, expected, 1e-5)
    weights = np.random.default_rng(5).normal(size=image.shape)
    (image * torch.tensor(weights, device=device)).sum().backward()
    for name in ("means", "opacities", "colors"):
        assert_close(inputs[name].grad, twin.slopes(v, name, options, weights, np.zeros(1)), 5e-4)


def test_the_opacity_alone_has_gradients(device):
    options, v = Options(26, 19), sample(4)
    inputs = leaves(v, device)
    opacity = rasterization(**inputs, **vars(options))[1]
    opacity.sum().backward()
    expected = twin.slopes(v, "scales", options, np.zeros(1), np.ones(1))
    assert_close(inputs["scales"].grad, expected, 5e-4)
    assert inputs["colors"].grad is None or not inputs["colors"].grad.any()


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("per_camera", [False, True])
def test_lower_degrees_use_the_first_harmonics(device, degree, per_camera):
    options, v = Options(26, 19, sh_degree=degree), sample(4, 2, (16, 3))
    if per_camera:
        v["colors"] = np.stack([v["colors"], -v["colors"]])
    image, _, _ = rasterization(**leaves(v, device), **vars(options))
    assert_close(image, twin.render(v, options)[0], 1e-5)


def test_colours_may_be_a_cameras_own(device):
    options, v = Options(26, 19), sample(4, 2)
    v["colors"] = np.stack([v["colors"], 1 - v["colors"]])
    image, _, _ = rasterization(**leaves(v, device), **vars(options))
    assert_close(image, twin.render(v, options)[0], 1e-5)


def one_line(depths: list[float], opacities: list[float], device: torch.device, **others: Any) -> tuple:
    """Wide white, red, green, ... Gaussians behind one another; the pixel at the centre, and meta."""
    count = len(depths)
    colors = torch.tensor([[1.0, 1, 1], [1, 0, 0], [0, 1, 0]], device=device)[:count]
    image, opacity, meta = rasterization(
        means=torch.tensor([[0.0, 0.0, depth] for depth in depths], device=device).reshape(-1, 3),
        quats=torch.tensor([[2.0, 0.0, 0.0, 0.0]] * count, device=device).reshape(-1, 4),
        scales=torch.full((count, 3), 0.5, device=device),
        opacities=torch.tensor(opacities, device=device),
        colors=colors,
        viewmats=torch.eye(4, device=device)[None],
        Ks=torch.tensor([[[40.0, 0, 16.5], [0, 40, 16.5], [0, 0, 1]]], device=device),
        width=33,
        height=33,
        **others,
    )
    return image[0], opacity[0, ..., 0], meta


def test_one_gaussian_has_the_closed_form(device):
    """A standard deviation of 0.5 at depth 4 with f 40 is 5 px, of which the filter makes sqrt(25.3)."""
    image, opacity, meta = one_line([4.0], [0.5], device)
    assert image[16, 16, 0].item() == pytest.approx(0.5, rel=1e-5)
    assert opacity[16, 21].item() == pytest.approx(0.5 * np.exp(-25 / 50.6), rel=1e-4)
    assert meta["conics"][0].tolist() == pytest.approx([1 / 25.3, 0, 1 / 25.3])
    assert meta["radii"].tolist() == [[np.ceil(np.sqrt(2 * np.log(127.5) * 25.3))] * 2]
    image, _, meta = one_line([4.0], [0.5], device, rasterize_mode="antialiased")
    assert image[16, 16, 0].item() == pytest.approx(0.5 * 25 / 25.3, rel=1e-5)
    assert meta["opacities"].item() == pytest.approx(0.5 * 25 / 25.3, rel=1e-5)


def test_depths_are_weighted_sums_or_means(device):
    """Weights at the centre are 0.5 of depth 4 and 0.25 of depth 8."""
    for mode, expected in (("D", [4]), ("ED", [4 / 0.75]), ("RGB+D", [0.75, 0.5, 0.5, 4])):
        image, opacity, _ = one_line([4.0, 8.0], [0.5, 0.5], device, render_mode=mode)
        assert image[16, 16].tolist() == pytest.approx(expected, rel=1e-5)
        assert opacity[16, 16].item() == pytest.approx(0.75)


def test_a_background_is_seen_through_what_is_left_but_not_as_depth(device):
    behind = torch.tensor([[0.0, 0.8, 0.4]], device=device)
    image, _, _ = one_line([4.0], [0.5], device, backgrounds=behind, render_mode="RGB+D")
    assert image[16, 16].tolist() == pytest.approx([0.5, 0.9, 0.7, 2], rel=1e-5)


@pytest.mark.parametrize(
    ("opacities", "expected"),
    [
        # No Gaussian hides all that is behind it.
        ([1.0], 0.999),
        # 0.05 * 0.001 would be transmitted: the pixel ends before, and for good.
        ([0.95, 1.0, 0.5], 0.95),
        ([0.85, 0.999], 0.85 + 0.15 * 0.999),
    ],
)
def test_pixels_end_as_in_gsplat(device, opacities, expected):
    _, opacity, _ = one_line([4.0, 5.0, 6.0][: len(opacities)], opacities, device)
    assert opacity[16, 16].item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("depth", "others"),
    [
        (-4.0, {}),
        (0.005, {}),
        (4.0, {"near_plane": 4.5}),
        (4.0, {"far_plane": 3.5}),
        (4.0, {"radius_clip": 30}),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_what_is_not_drawn_is_black_and_has_no_radius(device, depth, others, packed):
    image, opacity, meta = one_line([depth], [0.9], device, packed=packed, render_mode="RGB+ED", **others)
    assert not image.any()
    assert not opacity.any()
    assert meta["radii"].shape == ((0, 2) if packed else (1, 1, 2))
    assert not meta["radii"].any()


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("count", [0, 3])
def test_gradients_reach_what_is_not_drawn_as_zeros(device, packed, count):
    v = sample(count) | {"backgrounds": np.full((2, 3), 0.25)}
    v["means"][:, 2] = -9
    inputs = leaves(v, device)
    image, opacity, meta = rasterization(**inputs, width=20, height=12, packed=packed)
    assert (image == 0.25).all()
    meta["means2d"].retain_grad()
    (image.sum() + opacity.sum()).backward()
    assert (inputs["backgrounds"].grad == 20 * 12).all()
    for name in ("means", "quats", "scales", "opacities", "colors", "viewmats"):
        assert not inputs[name].grad.any(), name
    assert meta["means2d"].grad.shape == ((0, 2) if packed else (2, count, 2))


def test_packed_lists_what_is_drawn_and_draws_the_same(device):
    v = sample(6)
    v["means"][1, 2] = -20
    packed, all_of_them = (
        rasterization(**leaves(v, device), width=26, height=19, packed=packed) for packed in (True, False)
    )
    assert torch.equal(packed[0], all_of_them[0])
    assert torch.equal(packed[1], all_of_them[1])
    drawn = (all_of_them[2]["radii"] > 0).all(dim=-1)
    assert not drawn[:, 1].any()
    camera, gaussian = drawn.nonzero().unbind(1)
    assert packed[2]["camera_ids"].tolist() == camera.tolist()
    assert packed[2]["gaussian_ids"].tolist() == gaussian.tolist()
    for _, _, meta in (packed, all_of_them):
        meta["means2d"].retain_grad()
    for image, _, _ in (packed, all_of_them):
        image.square().sum().backward()
    for name in ("means2d", "radii", "depths", "conics", "opacities"):
        assert torch.equal(packed[2][name], all_of_them[2][name][drawn]), name
    assert torch.equal(packed[2]["means2d"].grad, all_of_them[2]["means2d"].grad[drawn])
    sizes = {name: packed[2][name] for name in ("width", "height", "n_cameras", "n_batches")}
    assert sizes == {"width": 26, "height": 19, "n_cameras": 2, "n_batches": 1}


@pytest.mark.parametrize("packed", [False, True])
def test_batches_and_cameras_are_drawn_as_if_alone(device, packed):
    scenes = [sample(4, 2, seed=seed) for seed in (0, 1)]
    batch = leaves({name: np.stack([v[name] for v in scenes])[:, None] for name in scenes[0]}, device)
    image, opacity, meta = rasterization(**batch, width=26, height=19, packed=packed, render_mode="RGB+D")
    assert image.shape == (2, 1, 2, 19, 26, 4)
    assert opacity.shape == (2, 1, 2, 19, 26, 1)
    assert meta["n_batches"] == 2
    if packed:
        assert set(meta["batch_ids"].tolist()) == {0, 1}
    for number, v in enumerate(scenes):
        for camera in range(2):
            alone = v | {name: v[name][camera : camera + 1] for name in ("viewmats", "Ks")}
            own = rasterization(**leaves(alone, device), width=26, height=19, render_mode="RGB+D")
            torch.testing.assert_close(image[number, 0, camera], own[0][0], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        pytest.param(name, value, marks=extreme(f"rasterization, {title}", given=given, expected=expected))
        for title, name, value, given, expected in (
            ("scale 1e15", "scales", 1e15, "one among three", "finite image and gradients"),
            ("scale 0", "scales", 0.0, "one among three", "finite image and gradients"),
            ("quaternion of length 0", "quats", 0.0, "one among three", "finite image and gradients"),
            ("at the camera", "means", 0.0, "one among three, camera there", "not drawn, finite gradients"),
            ("NaN", "means", np.nan, "one among three", "not drawn, others as without it"),
        )
    ],
)
def test_extreme_gaussians_spoil_nothing(each_arrays, got, name, value):
    v, drawn = sample(3), {"width": 26, "height": 19, "rasterize_mode": "antialiased"}
    if name == "means":
        v["viewmats"][:, :3, 3] = 0
        v["means"][:, 2] += 3
    v[name][0] = value
    inputs = leaves(v, each_arrays.device)
    for packed in (False, True):
        image, opacity, _ = rasterization(**inputs, **drawn, packed=packed, render_mode="RGB+ED")
        (image.sum() + opacity.sum()).backward()
        assert torch.isfinite(image).all()
        assert 0.1 < got(opacity.max().item(), ".3f") <= 1
    for leaf in ("means", "quats", "scales", "opacities", "colors"):
        assert torch.isfinite(inputs[leaf].grad[1:]).all(), leaf
        assert np.isnan(value) or torch.isfinite(inputs[leaf].grad[0]).all(), leaf
    if name == "means":
        others = {k: x if k in ("viewmats", "Ks") else x[1:] for k, x in v.items()}
        alone = rasterization(**leaves(others, each_arrays.device), **drawn)
        assert torch.equal(alone[1], opacity)


def test_float64_is_taken(device):
    v = sample(4)
    inputs = {name: leaf.detach().double().requires_grad_() for name, leaf in leaves(v, device).items()}
    image, _, _ = rasterization(**inputs, width=26, height=19)
    image.sum().backward()
    assert image.dtype == torch.float32
    assert inputs["means"].grad.dtype == torch.float64


def test_arguments_without_effect_are_taken(device):
    v = sample(3)
    plain = rasterization(**leaves(v, device), width=26, height=19)[0]
    others = {"tile_size": 8, "sparse_grad": True, "channel_chunk": 2, "segmented": True}
    defaults = {"camera_model": "pinhole", "covars": None, "with_ut": False, "distributed": False}
    assert torch.equal(
        rasterization(**leaves(v, device), width=26, height=19, **others, **defaults)[0], plain
    )


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"camera_model": "fisheye"}, NotImplementedError, "camera_model: only its default, pinhole"),
        ({"covars": torch.eye(3)}, NotImplementedError, "covars: only its default, None"),
        ({"distributed": True}, NotImplementedError, "distributed: only its default, False"),
        ({"with_ut": True}, NotImplementedError, "with_ut"),
        ({"colours": 1}, TypeError, "'colours'"),
        ({"render_mode": "rgb"}, ValueError, "render_mode 'rgb': must be one of RGB, D"),
        ({"rasterize_mode": "new"}, ValueError, "rasterize_mode 'new'"),
        ({"eps2d": -1.0}, ValueError, r"eps2d of -1 px\^2"),
        ({"width": 0}, ValueError, "images of 0 x 19"),
        ({"sh_degree": 4}, ValueError, "sh_degree 4: must be 0 to 3"),
        ({"sh_degree": 1}, ValueError, r"colors of shape \(3, 3\): must be .* with 4 harmonics"),
        ({"means": torch.zeros(3, 2)}, ValueError, r"means of shape \(3, 2\): must be \(\.\.\., N, 3\)"),
        ({"quats": torch.zeros(3, 3)}, ValueError, r"quats of shape \(3, 3\): must be \(3, 4\)"),
        ({"viewmats": torch.eye(4)}, ValueError, r"viewmats of shape \(4, 4\)"),
        ({"Ks": torch.eye(3)[None]}, ValueError, r"Ks of shape \(1, 3, 3\): must be \(2, 3, 3\)"),
        ({"colors": torch.zeros(4, 3)}, ValueError, r"colors of shape \(4, 3\): must be \(\.\.\., N, D\)"),
        ({"colors": torch.zeros(3, 0)}, ValueError, r"colors of shape \(3, 0\)"),
        ({"backgrounds": torch.zeros(3)}, ValueError, r"backgrounds of shape \(3,\): must be \(2, 3\)"),
        ({"absgrad": True, "render_mode": "RGB+D"}, ValueError, "absgrad with 4 channels: at most 3"),
        ({"scales": torch.zeros(3, 3, device="meta")}, ValueError, "on cpu, meta: must be on one device"),
    ],
)
def test_what_cannot_be_done_is_refused_by_name(changed, error, message):
    inputs = leaves(sample(3), torch.device("cpu")) | {"width": 26, "height": 19} | changed
    with pytest.raises(error, match=message) as caught:
        rasterization(**inputs)
    assert "\n" not in str(caught.value)


def test_an_image_is_differentiated_once(device):
    image, _, _ = rasterization(**leaves(sample(3), device), width=26, height=19)
    image.sum().backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="differentiated already"):
        image.sum().backward()


def test_points_of_a_real_scene_equal_the_twin(device):
    """Every 700th point of gsplat's own test data, as its three cameras see it, at a twelfth of the size."""
    with np.load(real_file("splats/garden_sfm/test_garden.npz")) as file:
        data = {name: file[name] for name in file.files}
    rng, means = np.random.default_rng(0), data["means3d"][::700].astype(float)
    v = {
        "means": means,
        "quats": rng.normal(size=(len(means), 4)),
        "scales": rng.uniform(0.02, 0.2, size=(len(means), 3)),
        "opacities": rng.uniform(0.3, 1, size=len(means)),
        "colors": data["colors"][::700] / 255,
        "viewmats": data["viewmats"].astype(float),
        "Ks": data["Ks"].astype(float) * [[1 / 12], [1 / 12], [1]],
    }
    options = Options(int(data["width"]) // 12, int(data["height"]) // 12, render_mode="RGB+ED")
    image, opacity, _ = rasterization(**leaves(v, device), **vars(options))
    expected, expected_opacity = twin.render(v, options)
    assert expected_opacity.mean() > 0.3
    # Where an alpha lies at the cut of 1/255, or a transmittance at that of 1e-4, rounding decides.
    for found, right in ((image[..., :3], expected[..., :3]), (opacity, expected_opacity)):
        error = np.abs(found.detach().cpu().numpy() - right)
        assert (error > 1e-4).mean() < 1e-3
        assert error.max() < 2 / 255


def test_gsplats_own_projection_agrees():
    reference = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    inputs = leaves(sample(30), torch.device("cpu"))
    inputs = {name: value.detach() for name, value in inputs.items()}
    _, _, meta = rasterization(**inputs, width=26, height=19, packed=False)
    covars, _ = reference._quat_scale_to_covar_preci(inputs["quats"], inputs["scales"], compute_preci=False)
    cameras = inputs["viewmats"], inputs["Ks"]
    _, means2d, depths, conics, _ = reference._fully_fused_projection(
        inputs["means"], covars, *cameras, 26, 19
    )
    for name, expected in (("means2d", means2d), ("depths", depths), ("conics", conics)):
        torch.testing.assert_close(meta[name], expected, rtol=1e-4, atol=1e-5)
