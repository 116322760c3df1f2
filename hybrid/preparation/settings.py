"""Settings of a preparation."""

from __future__ import annotations

from dataclasses import dataclass

from compose.base.errors import UserError
from compose.base.seeds import require_seed
from hybrid.preparation.stages import QUALITIES, SIDE

MOST_MINUTES = 10_000.0


@dataclass(frozen=True)
class PreparationSettings:
    """Settings of a preparation.

    Attributes:
        region: near, reachable, or a file with a camera path (pathtrace.region).
        quality: draft, standard or high; how far to go, unless minutes or psnr say it.
        minutes: time to use, over 0.
        psnr: dB on held-out views to reach, over 0.
        held_out: number of views that judge; none of them is trained on. Their time is not counted.
        size: width and height of these views in pixels.
        most_indirect: bound on what indirect light adds to a path of a training frame at once, over 0; none
            by default. Held-out views have no such bound.
        seed: of the views, trained on and held out, and of all else; same seed, same forest on the same
            machine, unless time decides how far it comes.

    Raises:
        UserError: a value is out of range, or minutes and psnr are both given.
    """

    region: str = "near"
    quality: str = "standard"
    minutes: float | None = None
    psnr: float | None = None
    held_out: int = 4
    size: tuple[int, int] = (SIDE, SIDE)
    most_indirect: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.quality not in QUALITIES:
            raise UserError(f"--quality {self.quality}: must be {', '.join(QUALITIES)}")
        if self.minutes is not None and not 0 < self.minutes <= MOST_MINUTES:
            raise UserError(f"--minutes {self.minutes:g}: must be over 0 and at most {MOST_MINUTES:g}")
        if self.psnr is not None and not 0 < self.psnr < float("inf"):
            raise UserError(f"--psnr {self.psnr:g}: must be over 0 dB")
        if self.minutes is not None and self.psnr is not None:
            raise UserError("--minutes and --psnr: give one of them")
        if self.held_out < 0:
            raise UserError(f"--held-out {self.held_out}: must not be negative")
        if self.psnr is not None and not self.held_out:
            raise UserError("--psnr: requires held-out views, which --held-out 0 leaves out")
        if self.most_indirect is not None and not 0 < self.most_indirect < float("inf"):
            raise UserError(f"--clamp-indirect {self.most_indirect:g}: must be a radiance over 0")
        require_seed(self.seed)
