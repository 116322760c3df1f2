"""Irradiance caches in files: stored once, restored whole, filled again if damaged."""

from __future__ import annotations

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from compose.base.errors import UserError
from hybrid.render.irradiance import stored_cache
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.cache.transport import Transfer
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import load_scene
from tests import small


@pytest.fixture(scope="module")
def cache(backend) -> IrradianceCache:
    scene = load_scene(small.corner())
    return fill_cache(scene, [scene.camera], points=1 << 12)


def never() -> IrradianceCache:
    raise AssertionError("filled again")


def parts(transfer: Transfer) -> list[np.ndarray]:
    points, rays, transport = transfer.points, transfer.rays, transfer.transport
    return [
        *(points.position, points.normal, transfer.patch, rays.point, rays.square),
        rays.weight,
        *(transfer.direct, transfer.reflected, transfer.passed, transfer.known),
        *(transport.patches.cells, transport.rays, transport.starts, transport.cells, transport.reflectance),
    ]


def assert_same(one: IrradianceCache, other: IrradianceCache) -> None:
    np.testing.assert_array_equal(one.irradiance, other.irradiance)
    np.testing.assert_array_equal(one.lights.keys, other.lights.keys)
    np.testing.assert_array_equal(one.lights.chances, other.lights.chances)
    np.testing.assert_array_equal(one.cells.grid.origin, other.cells.grid.origin)
    assert one.cells.grid.scale == other.cells.grid.scale
    for mine, yours in zip(parts(one.transfer), parts(other.transfer), strict=True):
        np.testing.assert_array_equal(mine, yours)
        assert mine.dtype == yours.dtype
    ours, theirs = ((*cells.keys, *cells.counts) for cells in (one.cells, other.cells))
    for mine, yours in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(mine, yours)
        assert mine.dtype == yours.dtype


def test_a_cache_is_filled_once_and_is_the_same_after_a_file(cache, tmp_path):
    file = tmp_path / "new" / "a.safetensors"
    assert stored_cache(file, lambda: cache) is cache
    assert_same(stored_cache(file, never), cache)


@pytest.mark.parametrize("damage", ["truncated", "missing", "short", "infinite", "links", "known", "flipped"])
def test_a_damaged_file_is_replaced(cache, tmp_path, damage):
    file = tmp_path / "a.safetensors"
    stored_cache(file, lambda: cache)
    arrays = load_file(file)
    if damage == "truncated":
        file.write_bytes(file.read_bytes()[:100])
    elif damage == "flipped":
        content = bytearray(file.read_bytes())
        content[-1000] ^= 1
        file.write_bytes(content)
    else:
        if damage == "missing":
            del arrays["keys.1"]
        elif damage == "links":
            arrays["links.cells"] = np.ascontiguousarray(arrays["links.cells"][1:])
        elif damage == "known":
            arrays["known"] = np.zeros_like(arrays["known"])
        elif damage == "short":
            arrays["irradiance"] = np.ascontiguousarray(arrays["irradiance"][:, 1:])
        else:
            arrays["irradiance"] = np.full_like(arrays["irradiance"], np.inf)
        save_file(arrays, file)
    assert stored_cache(file, lambda: cache) is cache
    assert_same(stored_cache(file, never), cache)


def test_an_empty_cache_goes_through_a_file(cache, tmp_path):
    empty = IrradianceCache.empty(1)
    stored_cache(tmp_path / "a.safetensors", lambda: empty)
    assert_same(stored_cache(tmp_path / "a.safetensors", never), empty)


def test_a_folder_that_cannot_be_written_is_named(cache, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        stored_cache(tmp_path / "file" / "a.safetensors", lambda: cache)
