"""Images in the memory of the device."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
import torch

from compose.base.arrays import Arrays
from compose.image.device_image import DeviceImage
from tests import small
from tests.compose.arrays_of import channels, floats, host, image_on, indices

# Width, height, stride, rows of the buffer, and floats per pixel.
BUFFERS = [
    (7, 5, 7, 5, 3),
    (7, 5, 16, 8, 3),
    (7, 5, 7, 8, 3),
    (7, 5, 16, 16, 4),
    (1, 1, 1, 1, 3),
    (1, 1, 16, 16, 4),
]


def image_in(arrays: Arrays, buffer: tuple[int, ...]) -> tuple[DeviceImage, np.ndarray]:
    """An image in a buffer of random numbers, and the same image in NumPy."""
    width, height, stride, rows, count = buffer
    values = small.rng().uniform(0, 2, (rows, stride, count)).astype(np.float32)
    image = DeviceImage(arrays, floats(arrays, values.ravel()), width, height, stride, count)
    return image, values[:height, :width, :3]


def address(values: np.ndarray) -> int:
    return values.__array_interface__["data"][0]


@pytest.mark.parametrize("buffer", BUFFERS)
def test_an_image_is_read_from_its_buffer(arrays, buffer):
    image, expected = image_in(arrays, buffer)
    np.testing.assert_array_equal(image.numpy(), expected)
    np.testing.assert_array_equal(np.array(image.tensor()), expected)
    height, width = expected.shape[:2]
    row, column = np.divmod(np.arange(height * width), width)
    every = image.at(indices(arrays, row), indices(arrays, column))
    np.testing.assert_array_equal(host(every), expected.reshape(-1, 3))


@pytest.mark.parametrize("buffer", BUFFERS)
def test_pixels_are_found_by_their_index(arrays, buffer):
    image, expected = image_in(arrays, buffer)
    chosen = small.rng(1).integers(0, image.width * image.height, 11)
    found = image.of_pixels(indices(arrays, chosen))
    np.testing.assert_array_equal(host(found), expected.reshape(-1, 3)[chosen])
    row, column = np.divmod(chosen, image.width)
    found = image.at(indices(arrays, row), indices(arrays, column))
    np.testing.assert_array_equal(host(found), expected[row, column])


@pytest.mark.parametrize("buffer", BUFFERS)
def test_a_packed_image_has_a_buffer_of_its_own(arrays, buffer):
    image, expected = image_in(arrays, buffer)
    assert image.is_packed == (buffer[:2] == (buffer[2], buffer[3]) and buffer[4] == 3)
    packed = image.packed()
    assert packed.is_packed
    assert (packed.width, packed.height) == (image.width, image.height)
    np.testing.assert_array_equal(packed.numpy(), expected)
    # Whoever writes to it leaves the image alone.
    dr.scatter(packed.values, arrays.plain.Float(9), arrays.plain.UInt(0))
    assert packed.numpy()[0, 0, 0] == 9
    np.testing.assert_array_equal(image.numpy(), expected)


@pytest.mark.parametrize("buffer", BUFFERS)
def test_pixels_are_changed_in_the_buffer(arrays, buffer):
    image, expected = image_in(arrays, buffer)
    before, expected = image.packed(), expected.copy()
    chosen = small.rng(1).permutation(image.width * image.height)[:11]
    radiance = small.rng(2).uniform(0, 2, (len(chosen), 3)).astype(np.float32)
    changed = image.changed(indices(arrays, chosen), channels(arrays, radiance))
    assert changed.values is image.values
    np.testing.assert_array_equal(before.numpy(), expected)
    row, column = np.divmod(chosen, image.width)
    expected[row, column] = radiance
    np.testing.assert_array_equal(changed.numpy(), expected)


def test_an_image_without_its_first_rows_is_changed_in_a_copy(arrays):
    image, _ = image_in(arrays, BUFFERS[1])
    part = DeviceImage(arrays, image.values, 7, 10, 16, 3, first_row=2)
    changed = part.changed(indices(arrays, np.array([0])), channels(arrays, np.full((1, 3), 9)))
    expected = part.packed().numpy().copy()
    assert (expected[:2] == 0).all()
    expected[0, 0] = 9
    np.testing.assert_array_equal(changed.numpy(), expected)


def test_numpy_and_torch_read_a_packed_image_without_a_copy():
    """On the CPU, of which this makes sure."""
    arrays = Arrays("llvm")
    image, expected = image_in(arrays, BUFFERS[0])
    tensor, start = image.tensor(), address(np.asarray(image.values))
    assert type(tensor) is arrays.plain.TensorXf
    assert tensor.shape == (5, 7, 3)
    assert address(image.numpy()) == start
    assert address(np.asarray(tensor)) == address(np.from_dlpack(tensor)) == start
    for read in (tensor.torch(), torch.from_dlpack(tensor)):
        assert read.data_ptr() == start
        assert read.shape == (5, 7, 3)
        np.testing.assert_array_equal(read.numpy(), expected)


def test_numpy_views_a_part_of_a_buffer_without_a_copy():
    image, expected = image_in(Arrays("llvm"), BUFFERS[3])
    view = image.numpy()
    assert address(view) == address(np.asarray(image.values))
    assert view.strides == (16 * 4 * 4, 4 * 4, 4)
    np.testing.assert_array_equal(view, expected)


@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (1, 90)])
def test_an_image_of_the_host_is_copied(arrays, shape):
    """Of any type and order in memory."""
    image = small.rng().uniform(0, 2, (*shape, 3))
    for given in (image, image.astype(np.float32), np.asfortranarray(image), image[::-1, ::-1][::-1, ::-1]):
        found = image_on(arrays, given)
        assert (found.height, found.width, found.is_packed) == (*shape, True)
        np.testing.assert_array_equal(found.numpy(), given.astype(np.float32))
    kept = image.astype(np.float32)
    found = image_on(arrays, kept)
    expected = kept.copy()
    kept[:] = 9
    np.testing.assert_array_equal(found.numpy(), expected)


def test_channels_become_an_image(arrays):
    image = small.rng().uniform(0, 2, (4, 6, 3)).astype(np.float32)
    given = channels(arrays, image.reshape(-1, 3))
    found = DeviceImage.filled(arrays, 6, 4, given)
    assert found.is_packed
    np.testing.assert_array_equal(found.numpy(), image)
    dr.scatter(found.values, arrays.plain.Float(9), arrays.plain.UInt(0))
    np.testing.assert_array_equal(host(given), image.reshape(-1, 3))
