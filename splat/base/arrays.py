"""The Dr.Jit array types of one backend, and the way between them and torch."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any, Literal

import drjit as dr
import torch

BackendName = Literal["llvm", "cuda"]


class Arrays:
    """Array types of the LLVM or the CUDA backend.

    Attributes:
        plain: the module of arrays without derivatives, in which kernels are written by hand.
        ad: the module of arrays that Dr.Jit differentiates.
    """

    def __init__(self, backend: BackendName):
        import drjit.cuda
        import drjit.llvm

        self.backend = backend
        self.plain: ModuleType = drjit.llvm if backend == "llvm" else drjit.cuda
        self.ad: ModuleType = self.plain.ad

    def number(self, value: int) -> Any:
        """A UInt of width 1 that kernels read, rather than a literal: then they are the same whatever it is.

        For all that depends on the size of a frame, the gaze or the camera.
        """
        return dr.opaque(self.plain.UInt, value)

    def from_torch(self, tensor: torch.Tensor) -> Any:
        """A differentiable flat Float of the tensor's elements; aliases a contiguous tensor's memory."""
        return self.ad.Float(tensor.detach().reshape(-1).contiguous())

    def to_torch(self, array: Any, device: torch.device) -> torch.Tensor:
        """A flat tensor of an array's elements; on the CPU it shares the memory."""
        return dr.detach(array, preserve_type=False).torch().to(device)

    def records(self, rows: list[Any]) -> Any:
        """Flat Float in which the rows' elements lie side by side, index by index.

        Records are read several times faster than rows wherever the index jumps.

        Args:
            rows: Floats of one width, a power of two of them; integers come as their bits.
        """
        count = max(dr.width(row) for row in rows)
        table = dr.empty(self.plain.Float, len(rows) * count)
        index = dr.arange(self.plain.UInt, count)
        dr.scatter(table, self.plain.ArrayXf(rows), index, mode=dr.ReduceMode.Permute)
        return table

    def record(self, table: Any, index: Any, size: int) -> list[Any]:
        """The `size` rows of a table of records, at an index."""
        record = dr.gather(self.plain.ArrayXf, table, index, shape=(size, dr.width(index)))
        return [record[k] for k in range(size)]

    def joined(self, parts: Sequence[Any]) -> Any:
        """Arrays of one type, one behind the other.

        `dr.concat` compiles another kernel for every combination of widths.
        """
        kind, widths = type(parts[0]), [dr.width(part) for part in parts]
        result, start = dr.empty(kind, sum(widths)), 0
        for part, width in zip(parts, widths, strict=True):
            # Arithmetic with arrays of no width is refused.
            if width:
                place = dr.arange(self.plain.UInt, width) + self.number(start)
                dr.scatter(result, part, place, mode=dr.ReduceMode.Permute)
            start += width
        return result

    def sorting(self, key: Any, below: int) -> Any:
        """Indices that sort an array of UInt, all less than `below`; equal ones keep their order.

        On the CPU one pass of a radix sort does for small keys, and two for larger ones, where `dr.argsort`
        makes three.
        """
        count = dr.width(key)
        if self.backend != "llvm" or not count:
            return dr.argsort(key)
        order, shift = None, 0
        while shift == 0 or below > 1 << shift:
            # Passes of up to 2^14 buckets stay in the cache.
            bits = 14 if below <= 1 << 14 else 11
            digit = (key if order is None else dr.gather(self.plain.UInt, key, order)) >> shift & (
                1 << bits
            ) - 1
            dr.eval(digit)
            step = dr.detail.block_mkperm(digit, count, min(1 << bits, -(-below // (1 << shift))))
            order = step if order is None else dr.gather(self.plain.UInt, order, step)
            shift += bits
        return order
