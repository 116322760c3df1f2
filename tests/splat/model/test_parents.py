"""Algorithm 1's search against a plain loop over all parents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.points import rows_of, z_curve_order
from splat.model.trees import Layer, label_codes, static_layer, with_parents
from tests.splat.samples import spheres


def line(x: list[float], sizes: float = 1.0) -> Layer:
    return static_layer(spheres(x, [sizes] * len(x)))


def cloud(n: int, seed: int) -> Layer:
    layer = line([0.0] * n)
    layer.gaussians.means[:] = torch.from_numpy(np.random.default_rng(seed).uniform(0, 9, (3, n)))
    return layer


def searched(below: Layer, above: Layer, tries: int) -> np.ndarray:
    """The parents, chosen by measuring every distance for every child."""
    parents, room = list(rows_of(above.gaussians.means)), [2] * len(above)
    result = np.empty(len(below), dtype=int)
    centres = rows_of(below.gaussians.means)
    for child in z_curve_order(centres):
        distances = np.linalg.norm(np.array(parents) - centres[child], axis=1)
        nearest = [k for k in np.argsort(distances, kind="stable")[:tries] if room[k]]
        if not nearest:
            parents.append(centres[child])
            room.append(2)
            nearest = [len(parents) - 1]
        room[nearest[0]] -= 1
        result[child] = nearest[0]
    return result


@pytest.mark.parametrize("tries", [1, 3, 16])
@pytest.mark.parametrize(("below", "above"), [(400, 60), (400, 300), (30, 1), (1, 5)])
def test_parents_are_those_of_a_plain_search(tries, below, above):
    children, parents = cloud(below, 1), cloud(above, 2)
    grown, found = with_parents(children, parents, np.full(below, -1), tries)
    np.testing.assert_array_equal(found, searched(children, parents, tries))
    assert len(grown) == max(above, found.max() + 1)
    assert torch.equal(grown.gaussians.means[:, :above], parents.gaussians.means)


def test_given_parents_stay_and_take_up_room():
    """Parent 0 has two given children; the third child, nearby, gets parent 1, the next nearest with room."""
    above, below = line([0.0, 5.0]), line([0.0, 0.1, 0.2])
    _, found = with_parents(below, above, np.array([0, 0, -1]), tries=2)
    assert found.tolist() == [0, 0, 1]
    grown, found = with_parents(below, above, np.array([0, 0, -1]), tries=1)
    assert found.tolist() == [0, 0, 2]
    assert grown.gaussians.means[0].tolist() == pytest.approx([0, 5, 0.2])


def test_a_parent_made_for_one_is_twice_as_large():
    grown, found = with_parents(line([7.0], 1.5), line([0.0]).part(0, 0), np.array([-1]), tries=1)
    assert found.tolist() == [0]
    assert grown.gaussians.log_scales.exp()[:, 0].tolist() == pytest.approx([3, 3, 3])
    assert grown.gaussians.means[0].tolist() == [7]
    assert grown.parent.tolist() == [-1]


def test_a_parent_made_for_two_has_their_moments():
    """Two spheres of sd 1 at 0 and 1: mean 1/2, variance along the line 1 + 1/4."""
    grown, found = with_parents(line([0.0, 1.0]), line([9.0]).part(0, 0), np.array([-1, -1]), tries=1)
    assert found.tolist() == [0, 0]
    assert grown.gaussians.means[0, 0].item() == pytest.approx(0.5)
    np.testing.assert_allclose(np.sort(grown.gaussians.log_scales.exp()[:, 0] ** 2), [1, 1, 1.25], rtol=1e-5)


def test_labels_never_mix():
    below = replace(line([0.0, 0.1]), semantic=torch.tensor([4, -1], dtype=torch.int32))
    above = line([0.0])
    grown, found = with_parents(below, above, np.array([-1, -1]), tries=4)
    # The second child is background as the given parent is; the first gets one of its own.
    assert found.tolist() == [1, 0]
    assert grown.semantic.tolist() == [-1, 4]


def test_codes_tell_labels_apart():
    semantic = torch.tensor([-1, -1, 0, 0, 1], dtype=torch.int32)
    dynamic = torch.tensor([False, True, False, True, False])
    layer = replace(line([0.0] * 5), semantic=semantic, dynamic=dynamic)
    codes, again = label_codes(layer), label_codes(layer)
    assert len(set(codes.tolist())) == 5
    assert codes.tolist() == again.tolist()
