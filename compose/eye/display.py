"""The display that a frame is shown on, as the viewer sees it."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera


@dataclass(frozen=True)
class Display:
    """The flat display that the viewer looks at, straight in front of its centre.

    A frame is shown pixel by pixel around the display's centre; one larger than the display would go on
    beyond its edges.

    Attributes:
        width, height: pixels.
        fov: width of the display in degrees, as the viewer sees it.
        luminance: of white, in cd/m2.

    Raises:
        UserError: a number is not finite or not positive, or the field of view is 180 degrees or more.
    """

    width: int
    height: int
    fov: float
    luminance: float = 200.0

    def __post_init__(self) -> None:
        for name in ("width", "height", "fov", "luminance"):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not np.isfinite(value) or value <= 0:
                raise UserError(f"display: {name} is {value}; must be a positive number")
        if self.fov >= 180:
            raise UserError(f"display: fov is {self.fov}; a flat display spans less than 180 degrees")

    @property
    def focal(self) -> float:
        """Distance of the eye in pixels."""
        return float(self.width / 2 / np.tan(np.radians(self.fov) / 2))

    @property
    def pixels_per_degree(self) -> float:
        """At the centre, where there are fewest."""
        return float(np.radians(1) * self.focal)

    def viewer(self, width: int, height: int) -> Camera:
        """The eye as a camera: what angles the pixels of a frame of this size are seen under."""
        return Camera(np.eye(4), width, height, self.focal, self.focal, width / 2, height / 2)


# A 24-inch monitor at half a metre; the headset of Fov-GS's study, one eye.
DISPLAYS = {"desktop": Display(1920, 1080, 55.0), "hmd": Display(1440, 1700, 97.0, 100.0)}


def display_named(source: str) -> Display:
    """A display by name, or from a JSON file with width, height, fov and, if it is known, luminance.

    Raises:
        UserError: the file is missing, or no such display.
    """
    if source in DISPLAYS:
        return DISPLAYS[source]
    names = ", ".join(DISPLAYS)
    try:
        entry = json.loads(Path(source).read_text())
        if not isinstance(entry, dict):
            raise TypeError("not an object")
        known = {field.name for field in fields(Display)}
        unknown = sorted(set(entry) - known)
        if unknown:
            raise UserError(f"--display {source}: does not know {unknown[0]}")
        return Display(**entry)
    except OSError as error:
        raise UserError(f"--display {source}: must be {names} or a JSON file ({error.strerror})") from error
    except (ValueError, TypeError) as error:
        raise UserError(
            f"--display {source}: must be JSON with width, height and fov (degrees across), from which the "
            f"pixels per degree follow ({error})"
        ) from error
    except UserError as error:
        raise UserError(f"--display {source}: {str(error).removeprefix(f'--display {source}: ')}") from error
