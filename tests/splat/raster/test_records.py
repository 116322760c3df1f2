"""Packed records: what is packed under a name is read back under it."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from compose.base.frozen import capacity
from splat.raster.records import RecordLayout, concatenated_records, records_before

# One load per table, loads that share a table, and both; with and without spare floats.
LAYOUTS = {
    "one load": ((8,), 1),
    "one load, full": ((8,), 0),
    "two tables": ((8, 2), 1),
    "three loads side by side": ((4, 4, 4), 2),
    "tables of two loads and of one": ((4, 4, 2), 3),
}


def made(loads: tuple[int, ...], spare: int) -> tuple[RecordLayout, int]:
    """A layout with a vector of 3, an integer and as many single floats as leave `spare` over."""
    singles = sum(loads) - spare - 4
    slots = {"a": 1, "vector": 3} | {f"s{k}": 1 for k in range(singles - 1)}
    return RecordLayout(loads, ("number",), **slots, number=1), singles - 1


def values(arrays, singles: int, count: int) -> dict:
    rng = np.random.default_rng(3)
    floats = lambda: arrays.plain.Float(rng.normal(size=count).astype(np.float32))  # noqa: E731
    numbers = arrays.plain.UInt(rng.integers(0, 2**32, count, dtype=np.uint32))
    row = {"a": floats(), "vector": [floats() for _ in range(3)], "number": numbers}
    return row | {f"s{k}": floats() for k in range(singles)}


@pytest.mark.parametrize("name", LAYOUTS)
def test_records_read_back_by_name(arrays, name):
    layout, singles = made(*LAYOUTS[name])
    assert layout.spare == LAYOUTS[name][1]
    packed = values(arrays, singles, 50)
    index = np.array([49, 0, 7, 7, 23], dtype=np.uint32)
    records = layout.pack(arrays, **packed)
    for found in (
        records.at(arrays.plain.UInt(index)),
        # Reordered, and then read where they lie now.
        records.gathered(arrays.plain.UInt(index[::-1].copy())).at(arrays.plain.UInt([4, 3, 2, 1, 0])),
    ):
        assert vars(found).keys() == packed.keys()
        for slot in packed.keys() - {"vector"}:
            np.testing.assert_array_equal(getattr(found, slot).numpy(), packed[slot].numpy()[index])
        for k in range(3):
            np.testing.assert_array_equal(found.vector[k].numpy(), packed["vector"][k].numpy()[index])


def test_a_load_brings_neighbours(arrays):
    """Slots lie side by side in their order; what is spare is 0."""
    Float = arrays.plain.Float
    layout = RecordLayout((4, 4, 2), x=1, colour=3, y=1, z=1, w=1, v=1, u=1)
    rows = {name: Float([k, k + 0.5]) for k, name in enumerate("xyzwvu")}
    colour = [Float([10, 20]), Float([11, 21]), Float([12, 22])]
    records = layout.pack(arrays, **rows, colour=colour)
    long, short = (table.numpy().tolist() for table in records.tables)
    # Both loads of four in one table, record by record.
    assert long == [0, 10, 11, 12, 1, 2, 3, 4, 0.5, 20, 21, 22, 1.5, 2.5, 3.5, 4.5]
    assert short == [5, 0, 5.5, 0]


def test_values_of_width_1_are_shared_by_all_records(arrays):
    layout = RecordLayout((2,), x=1, y=1)
    records = layout.pack(arrays, x=arrays.plain.Float([1, 2, 3]), y=arrays.plain.Float(9))
    assert records.tables[0].numpy().tolist() == [1, 9, 2, 9, 3, 9]


@pytest.mark.parametrize("loads", [(8,), (4, 4), (4, 2)])
def test_uploaded_records_equal_packed_ones(arrays, loads):
    layout = RecordLayout(loads, x=1, colour=3)
    x, colour = [1.0, 2.0], np.arange(6.0).reshape(3, 2)
    uploaded = layout.upload(arrays, x=x, colour=colour)
    packed = layout.pack(
        arrays, x=arrays.plain.Float(x), colour=[arrays.plain.Float(row) for row in colour.astype(np.float32)]
    )
    for a, b in zip(uploaded.tables, packed.tables, strict=True):
        np.testing.assert_array_equal(a.numpy(), b.numpy())


def test_records_are_concatenated_table_by_table(arrays):
    layout = RecordLayout((2, 1), x=1, y=1, z=1)
    """Of each part, the first two of three indices."""
    layout, some = RecordLayout((2, 1), x=1, y=1, z=1), arrays.plain.UInt([1, 0, 1])
    parts = [layout.upload(arrays, x=[k, k + 5], y=[k + 1] * 2, z=[k + 2] * 2) for k in (0, 10, 20)]
    whole = concatenated_records([(part, some, 2) for part in parts])
    found = whole.at(arrays.plain.UInt([5, 4, 0]))
    rows = [value.numpy().tolist() for value in (found.x, found.y, found.z)]
    assert rows == [[20, 25, 5], [21, 21, 1], [22, 22, 2]]
    assert len(whole) == capacity(6)


def test_integers_keep_all_their_bits(arrays):
    layout = RecordLayout((1,), ("n",), n=1)
    numbers = arrays.plain.UInt([0, 1, 2**24 + 1, 0x7FC00001, 2**32 - 1])
    for records in (layout.pack(arrays, n=numbers), layout.upload(arrays, n=numbers.numpy())):
        found = records.at(dr.arange(arrays.plain.UInt, 5)).n
        assert type(found) is arrays.plain.UInt
        np.testing.assert_array_equal(found.numpy(), numbers.numpy())


def test_other_numbers_lie_behind_records(arrays):
    layout = RecordLayout((4,), x=1, y=1)
    further = np.array([[7, 2**32 - 1], [5, 6]], dtype=np.uint32)
    records = records_before(arrays, layout, layout.rows(x=[1, 2], y=[3, 4]), further, np.float32([0.5]))
    assert records.at(arrays.plain.UInt([1, 0])).y.numpy().tolist() == [4, 3]
    behind = records.tables[0].numpy()[8:]
    assert behind[:4].view(np.uint32).tolist() == [7, 2**32 - 1, 5, 6]
    # As many as recordings tell apart.
    assert behind[4] == 0.5
    assert not behind[5:].any()
    assert len(behind) == capacity(13) - 8


def test_records_know_how_many_they_are(arrays):
    for loads in ((8,), (4, 4), (4, 2)):
        assert len(RecordLayout(loads, x=1).upload(arrays, x=[1, 2, 3])) == 3


def test_impossible_layouts_are_refused():
    with pytest.raises(ValueError, match=r"loads \(3,\): must be powers of two"):
        RecordLayout((3,), x=1)
    with pytest.raises(ValueError, match="slots of 5 floats do not fit loads of 4"):
        RecordLayout((4,), x=1, colour=3, y=1)
    with pytest.raises(ValueError, match=r"integers \['y', 'colour'\]: must be slots of width 1"):
        RecordLayout((4,), ("x", "y", "colour"), x=1, colour=3)


def test_wrong_names_are_refused(arrays):
    layout = RecordLayout((2,), x=1, y=1)
    one = arrays.plain.Float(1)
    for values in ({"x": one}, {"x": one, "y": one, "z": one}, {"x": one, "z": one}):
        with pytest.raises(ValueError, match=r"expected \['x', 'y'\]"):
            layout.pack(arrays, **values)
        with pytest.raises(ValueError, match=r"expected \['x', 'y'\]"):
            layout.upload(arrays, **{name: [1.0] for name in values})


@pytest.mark.parametrize("name", LAYOUTS)
def test_some_slots_of_some_records_are_overwritten(arrays, name):
    layout, singles = made(*LAYOUTS[name])
    packed = values(arrays, singles, 20)
    records = layout.pack(arrays, **packed)
    index, new = np.array([3, 19, 0], dtype=np.uint32), np.arange(9, dtype=np.float32).reshape(3, 3)
    records.write(arrays.plain.UInt(index), vector=[arrays.plain.Float(row) for row in new])
    found = records.at(dr.arange(arrays.plain.UInt, 20))
    for k in range(3):
        expected = packed["vector"][k].numpy().copy()
        expected[index] = new[k]
        np.testing.assert_array_equal(found.vector[k].numpy(), expected)
    for slot in packed.keys() - {"vector"}:
        np.testing.assert_array_equal(getattr(found, slot).numpy(), packed[slot].numpy())
