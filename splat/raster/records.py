"""Packed records: the numbers of one item side by side in memory, under names.

A packet load brings 2, 4 or 8 neighbouring floats at once. Where the index jumps from lane to lane, that is
several times faster than one load per number from separate arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from types import SimpleNamespace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike, NDArray

from compose.base.arrays import Arrays, uploaded
from compose.base.frozen import capacity

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt


@dataclass(frozen=True)
class Packet:
    """One packet load of a record."""

    floats: slice  # which of the record's floats it brings
    table: int  # number of the table that holds it
    stride: int  # packets per record in that table
    offset: int  # which of those it is

    @property
    def size(self) -> int:
        """Floats that it brings."""
        return self.floats.stop - self.floats.start

    def index(self, record: UInt) -> UInt:
        """Position in the table, in packets."""
        return record if self.stride == 1 else record * self.stride + self.offset


class RecordLayout:
    """Which number lies where in a record, and which packet loads bring it.

    The slots fill the record from its start; floats beyond the last one are spare, and 0. Consecutive loads
    of one size share a table, so that a long record lies in few cache lines; any other has its own.

        >>> layout = RecordLayout((4, 2), x=1, colour=3, tile=1, integers=("tile",))
        >>> layout.spare
        1

    ValueError if a load is not a power of two, the slots do not fit the loads, or an integer is not a
    slot of width 1.

    Args:
        loads: floats per packet load, powers of two.
        integers: slots that hold a UInt each, stored as its bits.
        slots: width of each slot in floats, in the order in which they lie in memory.

    Attributes:
        slots, packets: which of a record's floats each slot is, and what each load brings.
        spare: number of floats that no slot uses.
    """

    def __init__(self, loads: Sequence[int], integers: Sequence[str] = (), **slots: int):
        if any(load < 1 or load & (load - 1) for load in loads):
            raise ValueError(f"loads {tuple(loads)}: must be powers of two")
        self.spare = sum(loads) - sum(slots.values())
        if self.spare < 0:
            raise ValueError(f"slots of {sum(slots.values())} floats do not fit loads of {sum(loads)}")
        if wrong := [name for name in integers if slots.get(name) != 1]:
            raise ValueError(f"integers {wrong}: must be slots of width 1")
        self.integers = frozenset(integers)
        ends = np.cumsum([0, *slots.values()]).tolist()
        self.slots = {name: slice(*ends[k : k + 2]) for k, name in enumerate(slots)}
        self.packets: list[Packet] = []
        end = 0
        for table, (size, run) in enumerate(groupby(loads)):
            stride = len(list(run))
            for offset in range(stride):
                self.packets.append(Packet(slice(end, end + size), table, stride, offset))
                end += size

    def pack(self, arrays: Arrays, **values: Float | UInt | list[Float]) -> Records:
        """Packs arrays, by slot (N,) or of width 1, or a list of them; ValueError for names of no slots."""
        self._check_names(values)
        floats, Float = [], arrays.plain.Float
        for name in self.slots:
            rows = values[name]
            if not isinstance(rows, list):
                rows = [Float(dr.reinterpret_array(Float, rows) if name in self.integers else rows)]
            floats += rows
        floats += [Float(0) for _ in range(self.spare)]
        count = max(dr.width(row) for row in floats)
        return self.scattered(arrays, [floats[p.floats] for p in self.packets], count)

    def upload(self, arrays: Arrays, **values: ArrayLike) -> Records:
        """Packs numbers that are in host memory and copies them to the device."""
        host, tables = self.rows(**values), []
        for table in range(self.packets[-1].table + 1):
            own = [packet.floats for packet in self.packets if packet.table == table]
            tables.append(uploaded(arrays.plain.Float, host[:, own[0].start : own[-1].stop]))
        return Records(arrays, self, tables)

    def rows(self, **values: ArrayLike) -> NDArray[np.float32]:
        """(N, floats) records of numbers in host memory, by slot (N,), or (width, N) for wider ones."""
        self._check_names(values)
        count = max(np.shape(value)[-1] for value in values.values())
        host = np.zeros((count, self.packets[-1].floats.stop), dtype=np.float32)
        bits = host.view(np.uint32)
        for name, slot in self.slots.items():
            target = bits if name in self.integers else host
            target[:, slot] = np.reshape(values[name], (slot.stop - slot.start, -1)).T
        return host

    def scattered(self, arrays: Arrays, packets: Sequence[Sequence[Float]], count: int) -> Records:
        """`count` records of packets, one for each load."""
        tables, record = self.tables(arrays, count), dr.arange(arrays.plain.UInt, count)
        for packet, values in zip(self.packets, packets, strict=True):
            arrays.put_packet(tables[packet.table], values, packet.index(record))
        return Records(arrays, self, tables)

    def tables(self, arrays: Arrays, count: int) -> list[Float]:
        """Memory for so many records."""
        sizes = [packet.size * packet.stride for packet in self.packets if packet.offset == 0]
        return [dr.empty(arrays.plain.Float, size * count) for size in sizes]

    def _check_names(self, values: Mapping[str, object]) -> None:
        if values.keys() != self.slots.keys():
            raise ValueError(f"values for {sorted(values)}, expected {sorted(self.slots)}")


@dataclass(frozen=True)
class Records:
    """N records of one layout."""

    arrays: Arrays
    layout: RecordLayout
    tables: list[Float]  # flat, that hold them

    def __len__(self) -> int:
        first = self.layout.packets[0]
        return int(dr.width(self.tables[0]) // (first.size * first.stride))

    def at(self, index: UInt) -> SimpleNamespace:
        """The records at an index (M,): by slot an array (M,), or a list of them for a slot wider than 1."""
        floats = [value for packet in self.packets(index) for value in packet]
        found: dict[str, object] = {name: floats[slot] for name, slot in self.layout.slots.items()}
        for name, slot in self.layout.slots.items():
            if slot.stop - slot.start == 1:
                found[name] = floats[slot.start]
            if name in self.layout.integers:
                found[name] = dr.reinterpret_array(self.arrays.plain.UInt, floats[slot.start])
        return SimpleNamespace(**found)

    def write(self, index: UInt, **values: list[Float]) -> None:
        """Overwrites slots of the records at an index (M,), no record twice, by lists of floats (M,)."""
        # What still waits to be written, of another number of records, would run at the same time.
        dr.eval(self.tables)
        for name, rows in values.items():
            slot = self.layout.slots[name]
            for number, row in zip(range(slot.start, slot.stop), rows, strict=True):
                packet = next(p for p in self.layout.packets if p.floats.start <= number < p.floats.stop)
                place = packet.index(index) * packet.size + (number - packet.floats.start)
                dr.scatter(self.tables[packet.table], row, place, mode=dr.ReduceMode.Permute)

    def gathered(self, index: UInt) -> Records:
        """Copies of the records at an index (M,), in that order."""
        return self.layout.scattered(self.arrays, self.packets(index), dr.width(index))

    def packets(self, index: UInt) -> list[Sequence[Float]]:
        """The packets of the records at an index, one for each load."""
        packet = self.arrays.packet
        return [packet(self.tables[p.table], p.size, p.index(index)) for p in self.layout.packets]


def concatenated_records(parts: Sequence[tuple[Records, UInt, int]]) -> Records:
    """Some records of several parts of one layout, in order; behind them, any numbers, up to a capacity.

    Of each part there are its records, indices of some, and how many of those matter.
    """
    arrays, layout = parts[0][0].arrays, parts[0][0].layout
    tables, start = layout.tables(arrays, capacity(sum(count for _, _, count in parts))), 0
    for records, index, count in parts:
        lane = dr.arange(arrays.plain.UInt, dr.width(index))
        known, target = lane < arrays.constant(count), lane + arrays.constant(start)
        for packet, values in zip(layout.packets, records.packets(index), strict=True):
            arrays.put_packet(tables[packet.table], values, packet.index(target), known)
        start += count
    dr.eval(tables)
    return Records(arrays, layout, tables)


def records_before(
    arrays: Arrays, layout: RecordLayout, *parts: NDArray[np.float32 | np.int32 | np.uint32]
) -> Records:
    """Records of a layout with a single table, and behind them, in the same array, other numbers of 32 bits.

    The first one of the parts is the records' rows (N, floats).
    """
    flat = [part.ravel().view(np.float32) for part in parts]
    size = sum(map(len, flat))
    flat.append(np.zeros(capacity(size) - size, dtype=np.float32))
    return Records(arrays, layout, [uploaded(arrays.plain.Float, np.concatenate(flat))])
