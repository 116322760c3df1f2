"""The views from which samples were traced before, in device memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.base.traced_samples import ALWAYS
from compose.fovea.samples import RECORD

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# Views that are remembered.
MOST_VIEWS = 16
# Floats that tell where a sample is, loaded as one packet.
_PLACE = 4
# The last float of a place holds mover, view and class of gloss: 20 of the 24 bits that it holds exactly.
_GLOSS_BITS, _VIEW_BITS = 2, (MOST_VIEWS - 1).bit_length()
# Moments after which samples are dropped, since light has changed: shadows of two moments ago are seen.
MOST_MOMENTS = 1
# Samples for which there is room at first: a disc of a small frame.
_LEAST_ROOM = 1 << 12


@dataclass(frozen=True)
class EarlierView:
    """What was traced from one camera, for N of its pixels.

    Attributes:
        records: sixteen Floats (N,) (compose.fovea.samples), at least one sample each.
        position: three Floats (N,), of what was hit, in the world; of what moves, where that is at rest.
        gloss, mover: Float (N,) each, of what was hit.
        viewpoint: (3,) position of the camera.
        time: that it showed, from 0 to 1.
    """

    records: list[Float]
    position: list[Float]
    gloss: Float
    mover: Float
    viewpoint: NDArray[np.float64]
    time: float = 0.0


@dataclass(frozen=True)
class SamplePlaces:
    """Where M samples of earlier views are, as Dr.Jit arrays of width M.

    The position is three Floats, in the world, or at rest if it moves. UInts are the class of gloss of what
    was hit, the number of the view, less than MOST_VIEWS, and the number of what was hit among what moves.
    """

    position: list[Float]
    gloss: UInt
    view: UInt
    mover: UInt


class EarlierViews:
    """The samples of the last MOST_VIEWS views, one view after another in a ring.

    Once a view is added, nothing of it moves unless the ring must grow.

    Attributes:
        moment: what is seen now; set before views of it are added.
        viewpoints: (MOST_VIEWS, 3) positions of the cameras by number of their view; far away where there is
            none.
    """

    def __init__(self, arrays: Arrays):
        self.arrays, self.moment = arrays, ALWAYS
        self.clear()

    def clear(self) -> None:
        """Forgets all views."""
        self.viewpoints = np.full((MOST_VIEWS, 3), np.inf)
        # Times of views by number; numbers of samples of views, the oldest first.
        self._times = np.full(MOST_VIEWS, np.nan)
        self._sizes: deque[int] = deque()
        self._added = self._first = 0
        self._room = _LEAST_ROOM
        self._places, self._records = self._empty()

    @property
    def samples(self) -> int:
        """Number of samples of all views."""
        return sum(self._sizes)

    def of_now(self) -> NDArray[np.bool_]:
        """(MOST_VIEWS,) by number, whether a view shows the moment that is seen now."""
        return self._times == self.moment.time

    def add(self, view: EarlierView) -> None:
        """Adds a view; the oldest go where there are MOST_VIEWS, or MOST_MOMENTS other than now."""
        if len(self._sizes) == MOST_VIEWS:
            self._drop_oldest()
        now = self.moment.time
        while len({view.time, *self._times[~np.isnan(self._times)]} - {now}) > MOST_MOMENTS:
            self._drop_oldest()
        plain, constant = self.arrays.plain, self.arrays.constant
        number, size, before = self._added % MOST_VIEWS, dr.width(view.gloss), self.samples
        self.viewpoints[number], self._times[number] = view.viewpoint, view.time
        self._sizes.append(size)
        self._added += 1
        if before + size > self._room:
            self._grow(before, before + size)
        if size:
            tag = plain.UInt(view.gloss) | plain.UInt(view.mover) << (_GLOSS_BITS + _VIEW_BITS)
            tag |= constant(number << _GLOSS_BITS)
            slot = self._slot(dr.arange(plain.UInt, size) + constant(before))
            self._scatter([*view.position, plain.Float(tag)], view.records, slot)

    def _drop_oldest(self) -> None:
        number = (self._added - len(self._sizes)) % MOST_VIEWS
        self.viewpoints[number], self._times[number] = np.inf, np.nan
        self._first = (self._first + self._sizes.popleft()) % self._room

    def places(self, index: UInt) -> SamplePlaces:
        """Where the samples at an index (M,) are; the oldest view's first sample has index 0."""
        *position, tag = self.arrays.packet(self._places, _PLACE, self._slot(index))
        tag = self.arrays.plain.UInt(tag)
        gloss, view = tag & ((1 << _GLOSS_BITS) - 1), (tag >> _GLOSS_BITS) & (MOST_VIEWS - 1)
        return SamplePlaces(position, gloss, view, tag >> (_GLOSS_BITS + _VIEW_BITS))

    def records(self, index: UInt) -> list[Float]:
        """Sixteen Floats (M,): the records of the samples at an index."""
        return list(self.arrays.packet(self._records, RECORD, self._slot(index)))

    def _slot(self, index: UInt) -> UInt:
        """Where in the ring the samples at an index are."""
        # Its size is a power of two.
        return index + self.arrays.constant(self._first) & self.arrays.constant(self._room - 1)

    def _empty(self) -> tuple[Float, Float]:
        Float = self.arrays.plain.Float
        return dr.empty(Float, _PLACE * self._room), dr.empty(Float, RECORD * self._room)

    def _grow(self, samples: int, wanted: int) -> None:
        """Moves all samples to the start of a ring that has room for as many as wanted."""
        index = dr.arange(self.arrays.plain.UInt, samples)
        slot, packet = self._slot(index), self.arrays.packet
        places, records = packet(self._places, _PLACE, slot), packet(self._records, RECORD, slot)
        self._first, self._room = 0, 1 << (wanted - 1).bit_length()
        self._places, self._records = self._empty()
        if samples:
            self._scatter(places, records, index)

    def _scatter(self, places: Sequence[Float], records: Sequence[Float], slot: UInt) -> None:
        self.arrays.put_packet(self._places, places, slot)
        self.arrays.put_packet(self._records, records, slot)
        dr.eval(self._places, self._records)
