"""Continuous levels of detail: which nodes of a hierarchy are drawn, and how they turn into their parents."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from splat.lod.forest_renderer import ForestRenderer
from splat.lod.layer_images import CONTINUOUS, LayerImage
from splat.model.forest import Forest
from splat.model.hierarchy import HierarchyNodes
from splat.model.trees import static_layer
from splat.raster.cut import HierarchyCut, Turned, turned_footprints
from splat.raster.projection import Footprints
from tests.extremes import extreme
from tests.splat.lod.views import (
    CORNERS,
    drawn,
    everything,
    flat,
    frame_camera,
    no_cutoff,
    overlapping_forest,
    ramp,
)
from tests.splat.samples import gaussians


@pytest.fixture(scope="module")
def forest() -> Forest:
    return overlapping_forest()


@pytest.fixture(scope="module")
def cut(arrays, forest) -> HierarchyCut:
    return HierarchyCut(arrays, forest.hierarchy_nodes)


def octaves(nodes: HierarchyNodes, camera, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twin in float64: by how many octaves nodes exceed the levels where they are; their places in pixels."""
    means = nodes.gaussians.means.double().numpy().T
    pixels, depth = camera.project(means)
    ahead = np.linalg.norm(means - camera.position, axis=1) - nodes.radius
    with np.errstate(divide="ignore"):
        spread = max(camera.fx, camera.fy) / np.where(ahead > 0.01, ahead, 0)
    place = np.clip(pixels / 16, 0, np.array(levels.shape)[::-1] - 1.001)
    corner = place.astype(int)
    fx, fy = (place - corner).T
    x, y = corner.T
    level = (levels[y, x] * (1 - fx) + levels[y, x + 1] * fx) * (1 - fy)
    level += (levels[y + 1, x] * (1 - fx) + levels[y + 1, x + 1] * fx) * fy
    assert (depth > 0.01).all()
    return np.log2(nodes.size.astype(np.float64) * spread / level), pixels


def twin(nodes: HierarchyNodes, camera, levels: np.ndarray) -> dict[int, float]:
    """The nodes that are drawn, wherever they are, and how far each has turned into its parent."""
    excess, _ = octaves(nodes, camera, levels)
    found = {}
    for node, parent in enumerate(nodes.parent.tolist()):
        above = np.inf if parent < 0 else excess[parent]
        own = min(excess[node], 0) if node < nodes.leaves else excess[node]
        if own <= 0 < above:
            way = 0.0 if parent < 0 else -own / (above - own)
            found[node] = min(max((way - 0.7) / 0.3, 0), 1)
    return found


def selected(cut: HierarchyCut, camera, levels: np.ndarray) -> dict[int, float]:
    index, turned = cut.nodes(camera, levels, 1.0)
    return dict(zip(index.numpy().tolist(), turned.share.numpy().tolist(), strict=True))


@pytest.mark.parametrize("levels", [flat(0.5), flat(3), flat(12), ramp(0.3, 20)])
def test_nodes_are_those_between_their_own_level_and_their_parents(forest, cut, levels):
    camera = frame_camera()
    found, expected = selected(cut, camera, levels), twin(forest.hierarchy_nodes, camera, levels)
    assert 0 < len(found) <= len(expected)
    assert found.keys() <= expected.keys()
    for node, share in found.items():
        assert share == pytest.approx(expected[node], abs=1e-3)
    # Those that are left out lie beside the frame.
    nodes = forest.hierarchy_nodes
    _, pixels = octaves(nodes, camera, levels)
    inside = (pixels > 0).all(axis=1) & (pixels < (camera.width, camera.height)).all(axis=1)
    assert {node for node in expected if inside[node]} <= found.keys()


@pytest.mark.parametrize("levels", [flat(0.5), flat(3), flat(12)])
def test_each_leaf_is_shown_by_exactly_one_node(forest, levels):
    nodes = forest.hierarchy_nodes
    camera = frame_camera()
    found = twin(nodes, camera, levels)
    shown = []
    for leaf in range(nodes.leaves):
        line, node = [], leaf
        while node >= 0:
            line.append(node)
            node = int(nodes.parent[node])
        shown.append(sum(node in found for node in line))
    # The levels are the same everywhere; only how near nodes are differs.
    assert min(shown) == 1
    assert np.mean(np.array(shown) == 1) > 0.98


def test_the_finest_levels_show_the_leaves_alone(arrays, forest):
    renderer, camera = ForestRenderer(arrays, forest), frame_camera()
    image = lambda layer: [LayerImage(layer, 0, np.ones(CORNERS, np.float32))]  # noqa: E731
    given = camera, image(1), no_cutoff(), everything()
    continuous = drawn(renderer, camera, image(CONTINUOUS), no_cutoff(), everything(), None, flat(1e-4))
    assert np.array_equal(continuous.numpy(), drawn(renderer, *given).numpy())


def test_higher_levels_draw_fewer_nodes_and_keep_the_light(arrays, forest):
    renderer, camera = ForestRenderer(arrays, forest), frame_camera()
    images = [LayerImage(CONTINUOUS, 0, np.ones(CORNERS, np.float32))]
    frames = [
        drawn(renderer, camera, images, no_cutoff(), everything(), None, flat(level))
        for level in (0.1, 2, 4, 8)
    ]
    counts = [frame.nodes for frame in frames]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < 0.5 * counts[0]
    mean = [frame.numpy().mean() for frame in frames]
    np.testing.assert_allclose(mean, mean[0], rtol=0.3)


def test_nothing_pops_while_levels_rise(arrays, forest):
    """Changes from step to step shrink with the steps: a sixteenth of the step, less than a quarter of it."""
    renderer, camera = ForestRenderer(arrays, forest), frame_camera()
    images = [LayerImage(CONTINUOUS, 0, np.ones(CORNERS, np.float32))]

    def largest_change(steps: int) -> float:
        levels = np.geomspace(5, 7, steps + 1)
        frames = [drawn(renderer, camera, images, no_cutoff(), everything(), None, flat(x)) for x in levels]
        pixels = np.stack([frame.numpy() for frame in frames])
        assert np.ptp([frame.nodes for frame in frames]) > 20
        return float(np.abs(np.diff(pixels, axis=0)).max())

    assert largest_change(640) < largest_change(40) / 4


@pytest.mark.parametrize("most", [200, 100])
def test_levels_are_raised_until_few_nodes_are_left(cut, most):
    camera, levels = frame_camera(), ramp(0.5, 4)
    factor = cut.least_factor(camera, levels, most)
    count = lambda factor: len(selected(cut, camera, (levels * factor).astype(np.float32)))  # noqa: E731
    # Nodes on their way to their parents reach a little further into the frame.
    assert count(factor) <= 1.1 * most
    assert count(factor / 2 ** (2 / 32)) > 0.9 * most


def test_levels_of_few_enough_nodes_are_left_alone(cut):
    assert cut.least_factor(frame_camera(), flat(1), 10_000) == 1


@extreme(
    "Gaussians at most, fewer than roots", given="no Gaussian at all", expected="levels 1,024 times as high"
)
def test_levels_rise_no_further_than_by_ten_octaves(cut, got):
    assert got(cut.least_factor(frame_camera(), flat(1), 0)) == 1024


@extreme("continuous levels of an empty forest", given="a forest of 0 Gaussians", expected="black")
def test_a_hierarchy_of_nothing_shows_nothing(arrays, got):
    forest = Forest(static_layer(gaussians("overlap", 1, 0).part(0, 0)), (0,), 120.0, "", "")
    images = [LayerImage(CONTINUOUS, 0, np.ones(CORNERS, np.float32))]
    renderer = ForestRenderer(arrays, forest)
    frame = drawn(renderer, frame_camera(), images, no_cutoff(), everything(), None, flat(1))
    assert got(float(frame.numpy().max())) == 0


def footprints(arrays, rows: dict[str, list[float]]) -> Footprints:
    return Footprints(**{name: arrays.plain.Float(values) for name, values in rows.items()})


OWN = {"x": 1.0, "y": 2.0, "xx": 4.0, "xy": 1.0, "yy": 2.0, "opacity": 0.9, "red": 1.0, "depth": 3.0}
PARENT = {"x": 2.0, "y": 4.0, "xx": 9.0, "xy": -1.0, "yy": 5.0, "opacity": 0.64, "red": 2.0, "depth": 4.0}


def turned(arrays, share: float, heir: float) -> Turned:
    return Turned(arrays.plain.UInt(0), arrays.plain.Float(share), arrays.plain.Float(heir))


@pytest.mark.parametrize("heir", [0.0, 1.0])
@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_a_node_turns_into_its_parent_or_fades(arrays, share, heir):
    """Positions, covariances and colours are linear in the share, of what fades, too."""
    rest = {"green": 0.5, "blue": 0.25}
    conditional = [one["xx"] - one["xy"] ** 2 / one["yy"] for one in (OWN, PARENT)]
    own, parent = (
        OWN | rest | {"conditional": conditional[0]},
        PARENT | rest | {"conditional": conditional[1]},
    )
    both = (footprints(arrays, {name: [value] for name, value in one.items()}) for one in (own, parent))
    mixed = turned_footprints(*both, turned(arrays, share, heir))
    expected = {name: (1 - share) * own[name] + share * parent[name] for name in own}
    expected["opacity"] = (1 - share) * 0.9 + share * heir * 0.64
    determinant = expected["xx"] * expected["yy"] - expected["xy"] ** 2
    expected["conditional"] = determinant / expected["yy"]
    for name, value in expected.items():
        assert getattr(mixed, name)[0] == pytest.approx(value, rel=1e-5), name


def test_a_parent_without_a_footprint_changes_nothing(arrays):
    names = (*OWN, "green", "blue", "conditional")
    own, lost = ({name: [value] for name in names} for value in (0.5, np.nan))
    mixed = turned_footprints(footprints(arrays, own), footprints(arrays, lost), turned(arrays, 0.0, 1.0))
    assert all(dr.all(value == 0.5) for value in vars(mixed).values())
