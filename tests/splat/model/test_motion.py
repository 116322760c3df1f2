"""Motion of instances, against SciPy's rotations and a plain blend of pieces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from compose.camera.coordinate_systems import Place
from splat.model.motion import NodeMotion, Poses, posed
from tests.extremes import extreme
from tests.splat.samples import gaussians

STEPS, COUNT = 5, 3


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat()[..., [3, 0, 1, 2]]


def random_motion(seed: int = 1) -> tuple[NodeMotion, list[Rotation]]:
    rng = np.random.default_rng(seed)
    turns = [Rotation.from_rotvec(rng.normal(0, 0.7, (STEPS, 3))) for _ in range(COUNT)]
    # Either sign of a quaternion is the same turn.
    signs = rng.choice([-1, 1], (STEPS, COUNT, 1))
    rotations = np.stack([wxyz(turn) for turn in turns], axis=1) * signs
    motion = NodeMotion(
        torch.from_numpy(rotations),
        torch.from_numpy(rng.normal(size=(COUNT, 3))),
        torch.from_numpy(rng.normal(size=(STEPS, COUNT, 3))),
        torch.ones(COUNT, dtype=torch.int64),
    )
    return motion, turns


def pieced(*pieces: int) -> NodeMotion:
    """Instances of so many pieces each, which turn by less than half a turn."""
    rng, count = np.random.default_rng(3), sum(pieces)
    turns = Rotation.from_rotvec(rng.normal(0, 0.5, (STEPS * count, 3)))
    return NodeMotion(
        torch.from_numpy(wxyz(turns).reshape(STEPS, count, 4)),
        torch.from_numpy(rng.normal(size=(count, 3))),
        torch.from_numpy(rng.normal(size=(STEPS, count, 3))),
        torch.tensor(pieces),
    )


def plain_blend(motion: NodeMotion, time_step: int, instance: int, point: np.ndarray) -> np.ndarray:
    """Where a point of an instance is at a step, node by node in float64."""
    first = int(motion.pieces[:instance].sum())
    own = range(first, first + int(motion.pieces[instance]))
    centres = motion.centres.numpy()
    order = sorted(own, key=lambda piece: float(np.linalg.norm(point - centres[piece])))
    away = [float(np.linalg.norm(point - centres[piece])) for piece in order]
    beyond = away[4] if len(order) > 4 else 2 * away[-1]
    weights = np.array([max(0.0, 1 - near / beyond) ** 2 for near in away[:4]])
    place = np.zeros(3)
    for piece, weight in zip(order, weights / weights.sum(), strict=False):
        w, *xyz = motion.rotations[time_step, piece].numpy()
        turned = Rotation.from_quat([*xyz, w]).apply(point - centres[piece])
        place += weight * (turned + centres[piece] + motion.shifts[time_step, piece].numpy())
    return place


def test_nodes_of_what_deforms_follow_the_nearest_pieces():
    motion = pieced(1, 9, 3)
    g = gaussians("overlap", 60, 0)
    instance = torch.arange(60, dtype=torch.int32) % 4 - 1
    found = posed(g, instance, motion.at(0.5))
    for node in range(60):
        own, point = int(instance[node]), g.means[:, node].double().numpy()
        expected = point if own < 0 else plain_blend(motion, 2, own, point)
        np.testing.assert_allclose(found.means[:, node], expected, atol=2e-5)
    np.testing.assert_allclose(found.rotations.norm(dim=0), g.rotations.norm(dim=0), rtol=1e-5)


@extreme(
    "a node far from all pieces of what deforms",
    given="a million times as far as they are from each other",
    expected="finite, and moved with them",
)
def test_a_node_far_from_all_pieces_follows_them(got):
    motion = replace(pieced(8), rotations=torch.eye(4).double()[:1].expand(STEPS, 8, 4).contiguous())
    g, none = gaussians("overlap", 1, 0), torch.zeros(1, dtype=torch.int32)
    g.means = torch.tensor([[1e6], [0.0], [0.0]])
    moved = posed(g, none, motion.at(0.5)).means - g.means
    assert torch.isfinite(moved).all()
    shifts = motion.shifts[2]
    low, high = shifts.amin(dim=0), shifts.amax(dim=0)
    assert got(bool(((moved[:, 0] > low - 0.2) & (moved[:, 0] < high + 0.2)).all()))


def test_a_node_as_far_from_all_pieces_follows_all_alike():
    corners = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)]).double()
    motion = replace(pieced(8), centres=corners, rotations=pieced(8).rotations * 0 + torch.eye(4)[0])
    g, none = gaussians("overlap", 3, 0), torch.zeros(3, dtype=torch.int32)
    g.means = torch.zeros(3, 3)
    index, weights = motion.at(0.5).followed(g.means, none.long())
    torch.testing.assert_close(weights, torch.full((3, 4), 0.25))
    expected = motion.shifts[2][index[0]].mean(dim=0)
    np.testing.assert_allclose(posed(g, none, motion.at(0.5)).means[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("motion", [random_motion()[0], pieced(1, 9, 3)], ids=["rigid", "pieces"])
def test_a_course_is_what_nodes_do_at_all_times(motion):
    g = gaussians("overlap", 30, 0)
    instance = torch.arange(30, dtype=torch.int32) % 4 - 1
    course = motion.course(g, instance)
    for time in (0.9, 0.0, 0.4):
        expected, found = posed(g, instance, motion.at(time)), course(time)
        for name in ("means", "rotations"):
            torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=0, atol=0)


def test_pieces_that_move_alike_are_one_instance():
    """Of the same pose everywhere, any blend is that pose, and so is the way back."""
    one, _ = random_motion()
    many = NodeMotion(
        one.rotations[:, :1].expand(-1, 12, -1).contiguous(),
        torch.randn(12, 3, dtype=torch.float64),
        torch.zeros(STEPS, 12, 3, dtype=torch.float64),
        torch.tensor([12]),
    )
    step = one.at(0.3)
    turn = Rotation.from_quat(step.rotations[0, [1, 2, 3, 0]].numpy())
    shifts = torch.from_numpy(turn.apply(many.centres.numpy())) + step.offsets[0] - many.centres
    poses = replace(many, shifts=shifts.expand(STEPS, -1, -1).contiguous()).at(0.3)
    g, none = gaussians("overlap", 20, 0), torch.zeros(20, dtype=torch.int32)
    expected = posed(g, none, step)
    moved = posed(g, none, poses)
    np.testing.assert_allclose(moved.means, expected.means, atol=1e-5)
    np.testing.assert_allclose(posed(moved, none, poses.inverse()).means, g.means, atol=1e-5)


@pytest.mark.parametrize("time", [0.0, 0.1, 0.25, 0.6, 1.0])
def test_nodes_follow_the_course_of_their_instance(time):
    motion, turns = random_motion()
    g = gaussians("overlap", 40, 1)
    instance = torch.from_numpy(np.random.default_rng(0).integers(-1, COUNT, 40).astype(np.int32))
    found = posed(g, instance, motion.at(time))
    times = np.linspace(0, 1, STEPS)
    for node in range(40):
        own = int(instance[node])
        mean, turn = (
            g.means[:, node].double().numpy(),
            Rotation.from_quat(g.rotations[[1, 2, 3, 0], node].numpy()),
        )
        if own >= 0:
            pose = Slerp(times, turns[own])(time)
            shift = [np.interp(time, times, motion.shifts[:, own, axis].numpy()) for axis in range(3)]
            centre = motion.centres[own].numpy()
            mean, turn = pose.apply(mean - centre) + centre + shift, pose * turn
        np.testing.assert_allclose(found.means[:, node], mean, atol=1e-5)
        back = Rotation.from_quat(found.rotations[[1, 2, 3, 0], node].numpy())
        assert (back.inv() * turn).magnitude() < 1e-5
    for name in ("log_scales", "opacity_logits", "sh"):
        assert getattr(found, name) is getattr(g, name)


def test_the_inverse_brings_nodes_back_to_rest():
    motion, _ = random_motion()
    g = gaussians("overlap", 20, 1)
    instance = torch.arange(20, dtype=torch.int32) % COUNT
    poses = motion.at(0.35)
    back = posed(posed(g, instance, poses), instance, poses.inverse())
    np.testing.assert_allclose(back.means, g.means, atol=1e-5)
    np.testing.assert_allclose(back.rotations, g.rotations, atol=1e-5)


@pytest.mark.parametrize("motion", [random_motion()[0], pieced(1, 7, 3)], ids=["rigid", "pieces"])
def test_gradients_are_those_of_finite_differences(motion):
    poses, instance = motion.at(0.45), torch.tensor([-1, 0, 1, 2, 0])
    rng = np.random.default_rng(2)
    means = torch.from_numpy(rng.normal(size=(3, 5))).requires_grad_()
    rotations = torch.from_numpy(rng.normal(size=(4, 5))).requires_grad_()
    g = gaussians("overlap", 5, 0)

    def of(means: torch.Tensor, rotations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        g.means, g.rotations = means, rotations
        moved = posed(g, instance, poses)
        return moved.means, moved.rotations

    assert torch.autograd.gradcheck(of, (means, rotations))


def test_a_motion_in_a_place_is_the_same_motion():
    motion, _ = random_motion()
    place = Place((3.0, -2.0, 1.0), 0.5)
    origin = torch.tensor(place.origin, dtype=torch.float64)
    points = torch.randn(3, COUNT, dtype=torch.float64)
    world, own = motion.at(0.3), motion.placed(place).at(0.3)

    def moved(points: torch.Tensor, poses: Poses) -> torch.Tensor:
        g = gaussians("overlap", COUNT, 0)
        g.means, g.rotations = points, torch.ones(4, COUNT, dtype=torch.float64)
        return posed(g, torch.arange(COUNT), poses).means

    in_place = moved((points - origin[:, None]) / place.unit, own)
    torch.testing.assert_close(in_place * place.unit + origin[:, None], moved(points, world))


@pytest.mark.parametrize(
    ("name", "tensor", "said"),
    [
        ("rotations", torch.zeros(1, COUNT, 4, dtype=torch.float64), "1 poses; must be two or more"),
        ("rotations", torch.zeros(STEPS, 4, dtype=torch.float64), "rotations is"),
        ("centres", torch.zeros(COUNT + 1, 3, dtype=torch.float64), "centres is"),
        ("shifts", torch.zeros(STEPS, COUNT, 3), "shifts is torch.float32"),
        ("pieces", torch.tensor([1, 0, 2]), "one or more each"),
        ("pieces", torch.tensor([1, 1, 2]), "there are poses of 3"),
    ],
)
def test_shapes_are_checked(name, tensor, said):
    motion, _ = random_motion()
    tensors = motion.tensors()
    if name == "rotations" and tensor.ndim == 3:
        tensors["shifts"] = motion.shifts[:1]
    with pytest.raises(ValueError, match=said):
        NodeMotion(**{**tensors, name: tensor})


def test_forests_without_dynamic_nodes_are_not_copied():
    g = gaussians("overlap", 10, 0)
    assert posed(g, torch.full((10,), -1, dtype=torch.int32), random_motion()[0].at(0.5)) is g
