"""Fits the acuity model `resolution-limit` to people, and holds all acuity models against them.

    python -m benchmarks.fit_acuity FOLDER [--json FILE]

The folder has the tables of two public data sets: resolution_limit/resolution_limit_data.csv, the finest
gratings that 18 people saw (Ashraf, Chapiro and Mantiuk 2025), and castlecsf/contrast_sensitivity.csv,
contrast sensitivities of 18 studies (Ashraf et al. 2024).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks import column, csv_rows, parser_of, report
from compose.eye.acuity import ACUITY_MODELS, limit_sensitivity

Array = NDArray[np.float64]
# What the parameters are found from, and in units of.
_START = np.array([0.3, 0.005, 0.03, 0.7, 40.0])
# Spread of people in octaves of frequency, and of studies in log10 of sensitivity.
_PEOPLE, _STUDIES = 0.4, 0.15
# The cut-offs, the studies that went off the fovea, and all others: each of the three counts as much.
_OFF_AXIS = ("virsu1979", "virsu1982", "wright1983")
# Dimmer or smaller stimuli are none of a display's, and faster ones are seen by another channel.
_DIMMEST, _SMALLEST, _FASTEST = 1.0, 0.05, 1.0
_FREQUENCIES = np.exp2(np.linspace(-3, 8, 1200))


@dataclass(frozen=True)
class Cutoffs:
    """Finest gratings that people saw: N eccentricities in degrees, cycles per degree, numbers of people."""

    eccentricity: Array
    frequency: Array
    observer: NDArray[np.int64]

    def taken(self, kept: NDArray[np.bool_]) -> Cutoffs:
        """Some of them."""
        return Cutoffs(self.eccentricity[kept], self.frequency[kept], self.observer[kept])

    def errors(self, cutoff: Array) -> Array:
        """(N,) octaves by which a model's cut-offs (N,) lie over those of the people."""
        return np.log2(cutoff / self.frequency)


@dataclass(frozen=True)
class Sensitivities:
    """M contrast sensitivities in log10, what they were measured with, and the number of their study."""

    frequency: Array
    eccentricity: Array
    luminance: Array
    area: Array
    sensitivity: Array
    study: NDArray[np.int64]
    names: list[str]

    def errors(self, parameters: Array, factors: Array) -> Array:
        """(M,) log10 by which people are more sensitive than the model, each study with a factor."""
        stimuli = self.frequency, self.eccentricity, self.luminance, self.area
        model = np.log10(limit_sensitivity(*stimuli, tuple(parameters)))
        return self.sensitivity - factors[self.study] - model

    @property
    def weights(self) -> Array:
        """(M,) of squared errors; they sum to 1 over the studies off the fovea, and over the others."""
        off_axis = np.isin(np.array(self.names)[self.study], _OFF_AXIS)
        return np.where(off_axis, 1 / off_axis.sum(), 1 / (~off_axis).sum())


def load_cutoffs(folder: Path) -> Cutoffs:
    """The achromatic cut-offs, N = 50."""
    rows = csv_rows(folder / "resolution_limit" / "resolution_limit_data.csv")
    rows = [row for row in rows if row["color_direction"] == "1"]
    observers = np.array([int(row["observer"].removeprefix("Obs")) for row in rows])
    return Cutoffs(column(rows, "eccentricity_deg"), column(rows, "threshold_ppd") / 2, observers)


def load_sensitivities(folder: Path) -> Sensitivities:
    """The achromatic sensitivities to static gratings of a display's luminances."""
    rows = [
        row
        for row in csv_rows(folder / "castlecsf" / "contrast_sensitivity.csv")
        if row["achromatic"] == "1"
        and float(row["s_frequency_cpd"]) > 0
        and float(row["t_frequency_hz"]) <= _FASTEST
        and float(row["luminance_cd_m2"]) >= _DIMMEST
        and float(row["area_deg2"]) >= _SMALLEST
    ]
    names = sorted({row["dataset"] for row in rows})
    study = np.array([names.index(row["dataset"]) for row in rows])
    return Sensitivities(
        column(rows, "s_frequency_cpd"),
        column(rows, "eccentricity_deg"),
        column(rows, "luminance_cd_m2"),
        column(rows, "area_deg2"),
        np.log10(column(rows, "sensitivity")),
        study,
        names,
    )


def limits(parameters: Array, eccentricities: Array) -> Array:
    """(N,) cut-offs in cycles per degree of the model at eccentricities (N,), whatever its parameters."""
    places, back = np.unique(eccentricities, return_inverse=True)
    with np.errstate(under="ignore", divide="ignore"):
        found = limit_sensitivity(_FREQUENCIES, places[:, None], parameters=tuple(parameters))
        over = np.log10(found)
    cutoffs = []
    for row in over:
        last = min(int(np.flatnonzero(row >= 0).max(initial=0)), len(row) - 2)
        share = float(np.clip(row[last] / (row[last] - row[last + 1]), 0, 1))
        cutoffs.append(_FREQUENCIES[last] ** (1 - share) * _FREQUENCIES[last + 1] ** share)
    return np.array(cutoffs)[back]


def fit(cutoffs: Cutoffs, sensitivities: Sensitivities) -> tuple[Array, Array]:
    """The model's parameters (5,), and the log10 of each study's factor."""
    count = len(_START)
    weights = np.sqrt(sensitivities.weights) / _STUDIES
    weight = 1 / np.sqrt(len(cutoffs.frequency)) / _PEOPLE

    def errors(found: Array) -> Array:
        parameters, factors = found[:count] * _START, found[count:] * _STUDIES
        of_cutoffs = cutoffs.errors(limits(parameters, cutoffs.eccentricity))
        return np.concatenate([weights * sensitivities.errors(parameters, factors), weight * of_cutoffs])

    start = np.concatenate([np.ones(count), np.zeros(len(sensitivities.names))])
    found = least_squares(errors, start, diff_step=1e-4).x
    return found[:count] * _START, found[count:] * _STUDIES


def left_out(cutoffs: Cutoffs, sensitivities: Sensitivities) -> Array:
    """(N,) errors in octaves of the model for each person, fitted to all others."""
    errors = np.zeros(len(cutoffs.frequency))
    for observer in np.unique(cutoffs.observer):
        own = cutoffs.observer == observer
        parameters, _ = fit(cutoffs.taken(~own), sensitivities)
        errors[own] = cutoffs.taken(own).errors(limits(parameters, cutoffs.eccentricity[own]))
    return errors


def spread(cutoffs: Cutoffs, errors: Array) -> tuple[float, float]:
    """Standard deviation of people's errors (N,) in octaves: in the fovea, and what a degree adds."""
    places = np.unique(cutoffs.eccentricity)
    found = [float(errors[cutoffs.eccentricity == place].std()) for place in places]
    slope, foveal = np.polyfit(places, found, 1)
    return float(foveal), float(slope)


def compared(cutoffs: Cutoffs, errors: Array) -> dict[str, Any]:
    """The errors (N,) of a model in octaves: rms, and means by eccentricity."""
    places = np.unique(cutoffs.eccentricity)
    means = [float(errors[cutoffs.eccentricity == place].mean()) for place in places]
    return {"rms": float(np.sqrt(np.mean(errors**2))), "means": means}


def main() -> None:
    """Fits, prints what was found, and writes it."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    cutoffs, sensitivities = load_cutoffs(options.folder), load_sensitivities(options.folder)
    parameters, factors = fit(cutoffs, sensitivities)
    rest = sensitivities.errors(parameters, factors)
    models = {name: model for name, model in ACUITY_MODELS.items() if name != "none"}
    own = cutoffs.errors(limits(parameters, cutoffs.eccentricity))
    found = {
        "parameters": parameters.tolist(),
        "spread": spread(cutoffs, own),
        "left_one_out": compared(cutoffs, left_out(cutoffs, sensitivities)),
        "models": {
            name: compared(cutoffs, cutoffs.errors(model.cutoff(cutoffs.eccentricity)))
            for name, model in models.items()
        },
        "cutoffs": {name: model.cutoff(np.arange(0.0, 70, 10)).tolist() for name, model in models.items()},
        "studies": {
            name: {
                "factor": float(factors[number]),
                "rms": float(rest[sensitivities.study == number].std()),
                "points": int((sensitivities.study == number).sum()),
            }
            for number, name in enumerate(sensitivities.names)
        },
    }
    report(found, options.json)


if __name__ == "__main__":
    main()
