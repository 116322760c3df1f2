"""Results as JSON that every reader accepts: it has no NaN and no infinity."""

from __future__ import annotations

import json
import math
from typing import Any


def json_text(content: Any) -> str:
    """The content as an indented JSON document, in which numbers that are not finite are null.

    Args:
        content: of types that JSON has; tuples become lists.
    """
    return json.dumps(_finite(content), indent=1, allow_nan=False) + "\n"


def _finite(content: Any) -> Any:
    if isinstance(content, dict):
        return {name: _finite(value) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
