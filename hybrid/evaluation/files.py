"""Names of the images in the folder of an evaluation."""

from __future__ import annotations

from hybrid.evaluation.keys import Key


def image_name(view: int, key: Key | None) -> str:
    """File name of the frame of a method and budget in a view; of the reference if None."""
    name = "reference" if key is None else "-".join(key)
    return f"{view}-{name}.png".replace(",", "").replace(" ", "-")


def flip_name(view: int, key: Key) -> str:
    """File name of a frame's FLIP map."""
    return image_name(view, key).replace(".png", "-flip.png")
