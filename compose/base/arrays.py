"""The Dr.Jit array types of one backend, and conversion between them and torch."""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

import drjit as dr
import numpy as np
import torch
from numpy.typing import NDArray

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt

BackendName = Literal["llvm", "cuda"]
_NUMPY = {
    dr.VarType.Int32: np.int32,
    dr.VarType.UInt32: np.uint32,
    dr.VarType.Float32: np.float32,
    dr.VarType.Float64: np.float64,
}
# Bytes. Dr.Jit compiles other kernels for arrays that do not start at a multiple of it.
_ALIGNMENT = 64
ALIGNED_FLOATS = _ALIGNMENT // 4
# From so many keys per bucket on, sorting by one large digit is quicker than by two small ones.
_KEYS_PER_BUCKET = 4
_Array = TypeVar("_Array", bound=dr.ArrayBase)


@dataclass(frozen=True)
class Arrays:
    """Array types of a backend: `plain` ones for hand-written kernels, and `ad` ones with derivatives."""

    backend: BackendName

    @cached_property
    def plain(self) -> ModuleType:
        """Types without derivatives."""
        return import_module(f"drjit.{self.backend}")

    @cached_property
    def ad(self) -> ModuleType:
        """Types with derivatives."""
        return import_module(f"drjit.{self.backend}.ad")

    @property
    def device(self) -> torch.device:
        """Where torch's tensors share memory with the arrays; the host if torch has no CUDA."""
        return torch.device("cuda" if self.backend == "cuda" and torch.cuda.is_available() else "cpu")

    def constant(self, value: int) -> UInt:
        """UInt of width 1, cached, that kernels read from memory: a literal would be compiled into them.

        For everything that depends on the size of a frame, the gaze or the camera.
        """
        return constant(self.plain.UInt, value)

    def from_torch(self, tensor: torch.Tensor) -> Float:
        """Differentiable flat Float of a tensor's elements; shares the memory of a contiguous tensor."""
        return self.ad.Float(tensor.detach().reshape(-1).contiguous())

    def to_torch(self, array: dr.ArrayBase, device: torch.device) -> torch.Tensor:
        """Flat tensor of an array's elements; shares the memory on the CPU."""
        return cast("torch.Tensor", dr.detach(array, preserve_type=False).torch()).to(device)

    def argsort(self, key: UInt, bound: int) -> UInt:
        """Indices that sort keys, UInt (N,) less than `bound`, stably: equal keys keep their order.

        A radix sort: on the CPU one pass for bounds up to 2^14, or a quarter of the keys' number, and two up
        to 2^22; on a card a pass for each 8 bits. `dr.argsort` sorts by all 32 bits.
        """
        count = dr.width(key)
        if not count or bound <= 1:
            return dr.arange(self.plain.UInt, count)
        on_cpu, UInt = self.backend == "llvm", self.plain.UInt
        # The counters of 2^14 buckets fit the cache; those of more buckets are worth it if all are used.
        if on_cpu and bound <= max(1 << 14, count // _KEYS_PER_BUCKET):
            return self._permutation(key, bound)
        shift = bits = 11 if on_cpu else 8
        mask = (1 << bits) - 1
        order = self._permutation(key & mask, min(1 << bits, bound))
        while bound > 1 << shift:
            digit = dr.gather(UInt, key, order) >> shift & mask
            step = self._permutation(digit, min(1 << bits, -(-bound // (1 << shift))))
            order, shift = dr.gather(UInt, order, step), shift + bits
        return order

    def _permutation(self, digit: UInt, bound: int) -> UInt:
        """Indices that sort digits less than `bound` stably, in one pass."""
        dr.eval(digit)
        return self.plain.UInt(dr.detail.block_mkperm(self.plain.UInt(digit), dr.width(digit), bound))

    def scalars(self, kind: type[_Array], values: Sequence[float]) -> list[_Array]:
        """Numbers as arrays of a kind and of width 1 that kernels read from memory, all in one upload.

        Integers must not be divided by them: lanes beyond the last read 0, and the CPU stops at 0 / 0.
        """
        table = uploaded(kind, np.array(values, dtype=_NUMPY[dr.type_v(kind)]))
        # Read at a literal, each would be copied on its own.
        start = self.constant(0)
        return [dr.gather(kind, table, start + i) for i in range(len(values))]

    def rows_columns(self, index: UInt, width: int) -> tuple[UInt, UInt]:
        """Rows and columns, UInt each, of row-major indices UInt of an image of that width."""
        across = self.constant(width)
        row = index // across
        return row, index - row * across

    def packet(self, table: _Array, size: int, index: UInt, active: Bool | bool = True) -> Sequence[_Array]:
        """Rows of `size` numbers of a flat Float or Float64, by indices (N,), each loaded at once.

        They are an array (size, N); rows that are not active are 0.
        """
        kind = self.plain.ArrayXf64 if dr.type_v(table) == dr.VarType.Float64 else self.plain.ArrayXf
        return dr.gather(kind, table, index, active, shape=(size, dr.width(index)))

    def put_packet(
        self, table: Float, values: Sequence[Float], index: UInt, active: Bool | bool = True
    ) -> None:
        """Writes Floats (N,) to rows of a flat Float, each row at once; an index may occur only once."""
        dr.scatter(table, self.plain.ArrayXf(values), index, active, mode=dr.ReduceMode.Permute)


@lru_cache(maxsize=4096)
def _constant(kind: type[_Array], value: float) -> _Array:
    return dr.opaque(kind, value)


# Dr.Jit complains about arrays that outlive it.
atexit.register(_constant.cache_clear)


def constant(kind: type[_Array], value: float) -> _Array:
    """Array of a kind and of width 1 that is cached; see `Arrays.constant`."""
    # A new handle: changing it in place leaves the cached one alone.
    return kind(_constant(kind, value))  # type: ignore[arg-type]  # the stub hides that types are hashable


def uploaded(kind: type[_Array], values: NDArray[Any]) -> _Array:
    """Flat array of a kind, from a copy of numbers in host memory that have the kind's size.

    The same kernels serve all such arrays; those that share numpy's memory may be aligned in any way.
    """
    memory = np.empty(values.nbytes + _ALIGNMENT, dtype=np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    aligned = memory[start : start + values.nbytes].view(values.dtype)
    aligned[:] = values.reshape(-1)
    return kind(aligned)


def compressed(values: _Array, mask: Bool) -> _Array:
    """Those of N values whose mask is set, in order; waits for their count."""
    chosen = cast("UInt", dr.compress(mask))
    # Dr.Jit refuses to index with arrays of width 0.
    return dr.gather(type(values), values, chosen) if dr.width(chosen) else dr.zeros(type(values), 0)
