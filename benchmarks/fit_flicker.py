"""Fits the sensitivity to flicker to people, and holds it against each study.

    python -m benchmarks.fit_flicker FOLDER [--json FILE]

The folder has elatcsf/flicker_detection_datasets.csv, thresholds of eight studies (Cai et al. 2024).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks import column, csv_rows, parser_of, report
from compose.eye.flicker import FLICKER, flicker_sensitivity

Array = NDArray[np.float64]
# Dimmer stimuli are none of a display's; one stimulus had no edge.
_DIMMEST, _WHOLE_FIELD = 1.0, 1000.0
# Of the parameters all but the first are positive, and found as logarithms, from these on.
_START = np.log([30.0, 0.03, 0.004, 0.2, 0.02, 0.7])
# Spread of studies and of their factors, in log10 of sensitivity.
_SPREAD, _FACTORS = 0.3, 3.0
# The study whose absolute sensitivity counts: measured on a display by the authors of the collection.
_ABSOLUTE = "yancheng2024"


@dataclass(frozen=True)
class Thresholds:
    """N thresholds: numbers of their studies; Hz, degrees, cd/m2, square degrees; log10 of sensitivity."""

    names: list[str]
    study: NDArray[np.int64]
    frequency: Array
    eccentricity: Array
    luminance: Array
    area: Array
    sensitivity: Array

    def errors(self, parameters: Array) -> Array:
        """(N,) log10 by which people are more sensitive than the model."""
        stimuli = self.frequency, self.eccentricity, self.luminance, self.area
        return self.sensitivity - np.log10(flicker_sensitivity(*stimuli, tuple(parameters)))

    def of(self, kept: NDArray[np.bool_]) -> Thresholds:
        """Some of them."""
        arrays = [getattr(self, field.name)[kept] for field in fields(self)[2:]]
        return Thresholds(self.names, self.study[kept], *arrays)


def load(folder: Path) -> Thresholds:
    """The thresholds of a display's luminances, N = 460."""
    rows = [
        row
        for row in csv_rows(folder / "elatcsf" / "flicker_detection_datasets.csv")
        if float(row["luminance"]) >= _DIMMEST and float(row["radius"]) < _WHOLE_FIELD
    ]
    names = sorted({row["dataset"] for row in rows})
    columns = "t_frequency", "eccentricity", "luminance", "area", "sensitivity"
    arrays = [column(rows, name) for name in columns]
    arrays[-1] = np.log10(arrays[-1])
    study = np.array([names.index(row["dataset"]) for row in rows])
    return Thresholds(names, study, *arrays)


def fit(thresholds: Thresholds) -> Array:
    """The model's parameters (7,): all but the gain from all studies, each of which counts as much."""
    count, names = len(_START), thresholds.names
    numbers = np.bincount(thresholds.study, minlength=len(names))
    weights = 1 / (_SPREAD * np.sqrt(numbers[thresholds.study]))

    def errors(found: Array) -> Array:
        parameters, factors = np.append(0, np.exp(found[:count])), found[count:]
        rest = thresholds.errors(parameters) - factors[thresholds.study]
        return np.concatenate([weights * rest, (factors - factors.mean()) / _FACTORS])

    start = np.concatenate([_START, np.full(len(names), 2.0)])
    shape = np.exp(least_squares(errors, start, loss="soft_l1").x[:count])
    own = thresholds.of(thresholds.study == names.index(_ABSOLUTE))
    return np.append(np.median(own.errors(np.append(0, shape))), shape)


def compared(thresholds: Thresholds, parameters: Array) -> dict[str, dict[str, Any]]:
    """Of each study: points, log10 of its factor, what is left of it (rms), and its mean off the fovea."""
    errors, found = thresholds.errors(parameters), {}
    for number, name in enumerate(thresholds.names):
        own = thresholds.study == number
        factor = float(np.median(errors[own]))
        away = own & (thresholds.eccentricity > 0)
        found[name] = {
            "points": int(own.sum()),
            "factor": factor,
            "rms": float(np.sqrt(np.mean((errors[own] - factor) ** 2))),
            "off_axis": float(errors[away].mean() - factor) if away.any() else None,
        }
    return found


def main() -> None:
    """Fits, and reports the parameters, those in use, and how far these are from each study."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    thresholds, used = load(options.folder), np.array(FLICKER)
    found = {"parameters": fit(thresholds).tolist(), "used": list(FLICKER)}
    report({**found, "studies": compared(thresholds, used)}, options.json)


if __name__ == "__main__":
    main()
