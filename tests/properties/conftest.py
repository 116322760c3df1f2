"""A scene and a rough forest of it: those of the tests of frames."""

from __future__ import annotations

from tests.hybrid.conftest import little_work, own_home  # noqa: F401  (fixtures)
from tests.hybrid.render.conftest import forest, renderer, scene  # noqa: F401  (fixtures)
