"""Settings of a capture."""

from __future__ import annotations

from dataclasses import dataclass

from compose.base.seeds import require_seed


@dataclass(frozen=True)
class CaptureSettings:
    """Settings of a capture.

    Attributes:
        views: number of training views.
        held_out: number of further views, may be 0; splats are fitted to none, the fusion to two of three.
        width, height: frame size in pixels.
        spp: samples per pixel of a training view, which is denoised afterwards.
        held_out_spp: samples per pixel of a held-out view, which is denoised as well, at least 2.
        close_ups: multiples of the resolution at which parts of held-out views are rendered, too.
        monocular: whether views are those of one camera that sways around the scene's own, one instant after
            the other; otherwise they are free, and each shows a time of its own.
        seed: same seed, same frames; from 0 to compose.base.seeds.MOST_SEED.

    Raises:
        UserError: the seed is out of range.
        ValueError: a count or a size is not positive, or held-out views have a single sample per pixel.
    """

    views: int = 64
    held_out: int = 8
    width: int = 256
    height: int = 256
    spp: int = 32
    held_out_spp: int = 256
    close_ups: tuple[int, ...] = (2, 4)
    seed: int = 0
    monocular: bool = False

    def __post_init__(self) -> None:
        for name in ("views", "width", "height", "spp", "held_out_spp"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name.replace('_', '-')} is {getattr(self, name)}; must be positive")
        if self.held_out_spp < 2:
            raise ValueError("held-out-spp is 1; must be 2 or more, for two independent halves")
        if self.held_out < 0:
            raise ValueError(f"held-out is {self.held_out}; must not be negative")
        require_seed(self.seed)
