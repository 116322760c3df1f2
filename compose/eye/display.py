"""The display that a frame is shown on, as the viewer sees it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from compose.base.errors import UserError, one_line
from compose.base.files import read_json
from compose.camera.camera import Camera

# Narrowest display in degrees, less than the eye resolves.
_NARROWEST = 0.001


@dataclass(frozen=True)
class Display:
    """A flat display, its centre straight in front of the viewer.

    A frame is shown pixel by pixel around the display's centre; one that is larger extends beyond the edges.

    Attributes:
        width, height: pixels.
        fov: width of the display in degrees, as the viewer sees it.
        luminance: of white, in cd/m2.

    UserError if a number is not finite or not positive, or the field of view is less than 0.001 degrees, or
    180 or more.
    """

    width: int
    height: int
    fov: float
    luminance: float = 200.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, int | float) or not np.isfinite(value) or value <= 0:
                raise UserError(f"display {name} {value}: must be a positive number")
        if self.fov >= 180:
            raise UserError(f"display fov {self.fov}: a flat display spans less than 180 degrees")
        if self.fov < _NARROWEST:
            raise UserError(f"display fov {self.fov}: must be at least {_NARROWEST} degrees")

    @property
    def focal(self) -> float:
        """Distance from the eye to the display, in pixels."""
        return float(self.width / 2 / np.tan(np.radians(self.fov) / 2))

    @property
    def pixels_per_degree(self) -> float:
        """Pixels per degree at the centre, where they are fewest."""
        return float(np.radians(1) * self.focal)

    def viewer(self, width: int, height: int) -> Camera:
        """The eye as a camera: its rays through a frame of that size are the viewer's lines of sight."""
        return Camera(np.eye(4), width, height, self.focal, self.focal, width / 2, height / 2)


# A 24-inch monitor at half a metre; the headset of Fov-GS's study, one eye.
DISPLAYS = {"desktop": Display(1920, 1080, 55.0), "hmd": Display(1440, 1700, 97.0, 100.0)}


def display_named(source: str) -> Display:
    """A display by name, or from a JSON file with width, height, fov and, optionally, luminance.

    UserError if no display has that name, or the file is missing or invalid.
    """
    if source in DISPLAYS:
        return DISPLAYS[source]
    try:
        entry = read_json(Path(source), finite=False)
        if not isinstance(entry, dict):
            raise TypeError("not an object")
        names = [field.name for field in fields(Display)]
        if unknown := sorted(set(entry) - set(names)):
            raise UserError(f"{unknown[0]} is unknown; must have {', '.join(names)} only")
        return Display(**entry)
    except OSError as error:
        known = ", ".join(DISPLAYS)
        raise UserError(f"display {source}: must be {known} or a JSON file ({error.strerror})") from error
    except UserError as error:
        raise UserError(f"display {source}: {one_line(error)}") from error
    except (ValueError, TypeError) as error:
        needed = "must be JSON with width and height in pixels and fov in degrees"
        raise UserError(f"display {source}: {needed} ({one_line(error)})") from error
