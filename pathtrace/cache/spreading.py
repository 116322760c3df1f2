"""Light on its way from cell to cell, a few segments at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pathtrace.cache.transport import Transport, told_apart

# Steps at most in which new light has passed all segments.
_STEPS = 8


class Spreading:
    """Irradiance of cells that follows the light which falls on them directly.

    Args:
        transport: between the cells.
        sent: (S, C, 3) irradiance that comes from lights, as for `Transport.irradiance`.
        most: number of segments that count, as for `Transport.irradiance`.
    """

    def __init__(self, transport: Transport, sent: NDArray[np.float32], most: int):
        self._transport, self._next, self._sent = transport, 1, sent
        self._known = transport.every(sent, most)
        self._share = -(-(len(self._known) - 1) // _STEPS)

    @property
    def steps(self) -> int:
        """Steps after which nothing is left of the light before `restart`."""
        return -(-(len(self._known) - 1) // max(self._share, 1))

    def restart(self) -> None:
        """Lets the next steps begin with the first segment."""
        self._next = 1

    def step(self) -> None:
        """Passes light on by the next few segments; after the last one, by the first ones again."""
        for _ in range(self._share):
            self._next = self._next if self._next < len(self._known) else 1
            received = self._transport.received(self._known[: self._next])
            self._known[self._next] = self._sent[min(self._next, len(self._sent) - 1)] + received
            self._next += 1

    def light(self, sent: NDArray[np.float32]) -> None:
        """Sets the light (S, C, 3) that the next steps pass on."""
        self._sent, self._known[0] = sent, sent[0]

    def irradiance(self, cells: NDArray[np.int64]) -> NDArray[np.float32]:
        """(K, c, 3) of cells given by their indices, as of `IrradianceCache`."""
        return told_apart([np.take(light, cells, axis=0) for light in self._known])
