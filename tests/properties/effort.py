"""How many examples the property tests try."""

from __future__ import annotations

from hypothesis import HealthCheck, Phase, settings

# Enough to meet each kind of scene, few enough for every run; a test marked `long` multiplies them.
FEW, MANY = 12, 300


def tried(examples: int = FEW) -> settings:
    """Examples that are the same in every run and on every machine, whatever profile is loaded."""
    return settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        # A smaller seed is no simpler a scene.
        phases=[Phase.explicit, Phase.generate],
        report_multiple_bugs=False,
        # Compiling the first kernel takes longer than any example may.
        suppress_health_check=list(HealthCheck),
    )
