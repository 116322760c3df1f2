"""How far light travels that paths get from a cache."""

from __future__ import annotations

from pathtrace.scene.scene import Scene


def segments_beyond_cache(scene: Scene) -> int:
    """Segments that a path may take beyond the cache, at least 1; -1 for no bound.

    One of a path's segments leads to the first surface, and one from there to the cache.
    """
    return max(1, scene.max_depth - 2) if scene.max_depth >= 0 else -1
