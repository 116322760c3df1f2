"""Numbers in buffers."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.gltf.document import read_array, read_document
from tests.pathtrace.gltf.building import Building


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
def test_floats_integers_and_fractions(tmp_path, suffix):
    building = Building()
    floats = building.array([[1.5, 2, 3], [4, 5, 6]])
    integers = building.array([1, 70000], "uint32")
    unsigned = building.array([[0, 255, 51]], "uint8", normalized=True)
    signed = building.array([[-32768, 32767, 0]], "int16", normalized=True)
    document = read_document(building.save(tmp_path / f"a{suffix}"))
    np.testing.assert_array_equal(read_array(document, floats, 3, "test"), [[1.5, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(read_array(document, integers, 1, "test"), [[1], [70000]])
    np.testing.assert_allclose(read_array(document, unsigned, 3, "test"), [[0, 1, 0.2]])
    np.testing.assert_array_equal(read_array(document, signed, 3, "test"), [[-1, 1, 0]])


def test_rows_may_lie_apart(tmp_path):
    building = Building()
    rows = np.arange(12, dtype="<f4").reshape(3, 4)
    view = building.view(rows.tobytes(), byteStride=16)
    index = building.add(
        "accessors", bufferView=view, byteOffset=4, componentType=5126, count=3, type="VEC3", min=[0], max=[1]
    )
    document = read_document(building.save(tmp_path / "a.gltf"))
    np.testing.assert_array_equal(read_array(document, index, 3, "test"), rows[:, 1:])


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_elements_replace_those_they_are_based_on(tmp_path, has_base):
    building = Building()
    index = building.array(np.ones((4, 2)))
    where = building.view(np.array([1, 3], dtype="u1").tobytes())
    values = building.view(np.array([[5, 6], [7, 8]], dtype="<f4").tobytes())
    building.tree["accessors"][index]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": where, "componentType": 5121},
        "values": {"bufferView": values},
    }
    if not has_base:
        del building.tree["accessors"][index]["bufferView"]
    document = read_document(building.save(tmp_path / "a.gltf"))
    base = 1.0 if has_base else 0.0
    wanted = [[base, base], [5, 6], [base, base], [7, 8]]
    np.testing.assert_array_equal(read_array(document, index, 2, "test"), wanted)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"count": 4}, "ends beyond its buffer view"),
        ({"byteOffset": 8}, "ends beyond its buffer view"),
        ({"type": "VEC2"}, "is a VEC2"),
        ({"componentType": 5130}, "of type 5130"),
        ({"bufferView": 9}, r"refers to bufferViews\[9\]; there are 1"),
        ({"count": 10**12}, "has 1,000,000,000,000 elements"),
    ],
)
def test_what_lies_elsewhere_is_refused(tmp_path, change, said):
    building = Building()
    index = building.array([[1.5, 2, 3], [4, 5, 6]])
    building.tree["accessors"][index].update(change)
    document = read_document(building.save(tmp_path / "a.gltf"))
    with pytest.raises(UserError, match=said):
        read_array(document, index, 3, "test")


def test_numbers_that_are_not_finite_are_refused(tmp_path):
    building = Building()
    index = building.view(np.array([np.nan], dtype="<f4").tobytes())
    building.add("accessors", bufferView=index, componentType=5126, count=1, type="SCALAR")
    document = read_document(building.save(tmp_path / "a.gltf"))
    with pytest.raises(UserError, match="not finite"):
        read_array(document, 0, 1, "test")
