"""Images of the page, embedded so that it is one file."""

from __future__ import annotations

import base64
import io
from pathlib import Path

from PIL import Image as PillowImage

from hybrid.evaluation.files import flip_name, image_name
from hybrid.evaluation.keys import Key

# Images in the page are compressed; the PNG files beside it are not.
_JPEG_QUALITY = 90


def embedded_images(folder: Path, view: int, keys: list[Key]) -> dict[str, str]:
    """Data URLs of a view's frames by the method's label, the reference first."""
    names = {"reference": image_name(view, None)}
    names |= {key.label: image_name(view, key) for key in keys}
    return {name: _data_url(folder / file) for name, file in names.items()}


def embedded_flips(folder: Path, view: int, keys: list[Key]) -> dict[str, str]:
    """Data URLs of a view's FLIP maps by the method's label, as far as there are any."""
    files = {key.label: folder / flip_name(view, key) for key in keys}
    return {name: _data_url(file) for name, file in files.items() if file.exists()}


def _data_url(file: Path) -> str:
    buffer = io.BytesIO()
    PillowImage.open(file).convert("RGB").save(buffer, format="JPEG", quality=_JPEG_QUALITY, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
