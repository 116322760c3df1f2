"""Conversion to and from torch, concatenation and sorting."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
import torch

from compose.base.arrays import Arrays, compressed, uploaded


def test_a_number_is_read_from_memory(arrays):
    number = arrays.constant(7)
    assert number.numpy().tolist() == [7]
    # A literal would be compiled into the kernels that use it.
    assert number.state == dr.VarState.Evaluated


def test_a_constant_is_made_once_and_cannot_be_changed(arrays):
    one, other = arrays.constant(7), arrays.constant(7)
    assert one.state == dr.VarState.Evaluated
    assert one.index == other.index
    one += 1
    assert (one.numpy().tolist(), other.numpy().tolist()) == ([8], [7])
    dr.scatter(other, arrays.plain.UInt(9), arrays.plain.UInt(0))
    assert arrays.constant(7).numpy().tolist() == [7]


@pytest.mark.parametrize("size", [1, 3, 100])
def test_scalars_are_read_from_memory(arrays, size):
    plain, index = arrays.plain, dr.arange(arrays.plain.UInt, size)
    least, most = arrays.scalars(plain.UInt, [5, 2**32 - 1])
    assert (index + least).numpy().tolist() == list(range(5, size + 5))
    assert (index + most).numpy().tolist() == [2**32 - 1, *range(size - 1)]
    half, far = arrays.scalars(plain.Float, [0.5, np.inf])
    assert (plain.Float(index) + half).numpy().tolist() == [i + 0.5 for i in range(size)]
    assert np.isinf((plain.Float(index) + far).numpy()).all()


@pytest.mark.parametrize("kept", [[], [0], [2, 5], [0, 1, 2, 3, 4, 5]])
def test_those_that_a_mask_chooses_are_kept_in_order(arrays, kept):
    values = uploaded(arrays.plain.Float, np.arange(6, dtype=np.float32) * 10)
    mask = np.isin(np.arange(6), kept)
    assert compressed(values, arrays.plain.Bool(mask)).numpy().tolist() == [10 * i for i in kept]


def test_backends_have_their_own_types():
    cpu, gpu = Arrays("llvm"), Arrays("cuda")
    assert dr.backend_v(cpu.plain.Float) == dr.JitBackend.LLVM
    assert dr.backend_v(gpu.plain.Float) == dr.JitBackend.CUDA
    assert dr.is_diff_v(cpu.ad.Float)
    assert not dr.is_diff_v(cpu.plain.Float)


@pytest.mark.parametrize("start", range(5))
def test_uploaded_numbers_are_copies_at_aligned_addresses(arrays, start):
    numbers = np.arange(40, dtype=np.float32)[start:]
    array = uploaded(arrays.plain.Float, numbers.reshape(-1, 1))
    wanted = numbers.tolist()
    numbers[:] = 0
    assert array.numpy().tolist() == wanted
    # On a GPU, numpy sees a copy.
    assert arrays.backend == "cuda" or array.numpy().ctypes.data % 64 == 0
    assert dr.width(uploaded(arrays.plain.UInt, np.zeros(0, dtype=np.uint32))) == 0


def test_tensors_go_there_and_back(arrays):
    tensor = torch.arange(6.0).reshape(2, 3)
    there = arrays.from_torch(tensor)
    assert there.numpy().tolist() == [0, 1, 2, 3, 4, 5]
    back = arrays.to_torch(there * 2, tensor.device)
    assert back.tolist() == [0, 2, 4, 6, 8, 10]


def test_a_transposed_tensor_is_read_in_its_own_order(arrays):
    assert arrays.from_torch(torch.arange(6.0).reshape(2, 3).T).numpy().tolist() == [0, 3, 1, 4, 2, 5]


def test_on_the_cpu_memory_is_shared():
    tensor = torch.zeros(4)
    array = Arrays("llvm").from_torch(tensor)
    tensor[2] = 5
    assert array.numpy().tolist() == [0, 0, 5, 0]


# One pass up to 16384 or a quarter of the count, two of 11 bits up to 2^22, three beyond.
@pytest.mark.parametrize("bound", [1, 2, 5, 2047, 16384, 16385, 70_000, 1 << 22, (1 << 22) + 1, 1 << 26])
@pytest.mark.parametrize("count", [1, 1000, 100_000])
def test_sorting_is_stable(arrays, bound, count):
    keys = np.random.default_rng(bound).integers(0, bound, count, dtype=np.uint32)
    # Many equal keys, and the largest possible one.
    keys[::3] = keys[0]
    keys[-1] = bound - 1
    order = arrays.argsort(arrays.plain.UInt(keys), bound).numpy()
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))


def test_sorting_nothing_gives_nothing(arrays):
    assert dr.width(arrays.argsort(dr.zeros(arrays.plain.UInt, 0), 5)) == 0
