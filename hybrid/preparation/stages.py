"""How far a preparation goes: its settings, its stages, and what regions and scenes take of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from compose.base.errors import UserError, as_plain_numbers, require_seed

# What there is to model grows with this power of the views that a region takes: some surfaces take many views
# to be seen at all, behind and between things.
_SURFACES = 0.7


@dataclass(frozen=True)
class Needs:
    """What a region and a scene take, over the default region of a scene that nobody has looked at."""

    breadth: float = 1.0  # views of the region until little is unseen
    detail: float = 1.0  # Gaussians for equal breadth

    @property
    def gaussians(self) -> float:
        """Gaussians that they take."""
        return self.breadth**_SURFACES * self.detail


# Pixels of a side of a frame at scale 1.
SIDE = 256
# Larger frames are parts of a view, so that what they cost does not grow with the resolution.
_LARGEST_SIDE = 512
# Fewer samples leave the denoiser nothing to go by.
LEAST_SPP = 4
# Side in pixels of what a whole view measures at the resolution of the coarsest layer: what sees less detail
# than that is hardly part of any frame, with any display or acuity model.
_COARSEST = 64


@dataclass(frozen=True)
class Stage:
    """What is added, and how long is trained on all that there is."""

    views: int  # new ones
    scale: float  # resolution of these, in units of a view of SIDE x SIDE
    spp: int  # samples per pixel that views at scale 1 have afterwards; those with smaller pixels have fewer
    gaussians: int  # in the finest layer at the end
    steps: int  # of the optimizer, over all layers
    breadth: float = 1.0  # of the region that it is for
    extra: bool = False  # beside those that are planned
    opens: bool = False  # the first one with views of another place

    @property
    def whole(self) -> int:
        """Side in pixels that a whole view has at the resolution of the new frames."""
        return round(SIDE * self.scale)

    @property
    def side(self) -> int:
        """Side in pixels of the new frames, which show a part of a view if it would be larger."""
        return min(self.whole, _LARGEST_SIDE)

    @property
    def layers(self) -> int:
        """Layers of the forest after this stage; the coarsest shows a whole view in about 64 pixels."""
        return max(1, (self.whole // _COARSEST).bit_length())

    def spp_at(self, scale: float) -> int:
        """Samples per pixel that views at some scale are worth in this stage; 0 where no more are."""
        # Frames of far larger pixels hardly matter for what the new ones show.
        return max(LEAST_SPP, int(self.spp / scale**2)) if 2 * scale >= self.scale else 0

    def for_needs(self, needs: Needs) -> Stage:
        """The stage for a region and a scene other than those it is described for.

        In broad regions, forests lack views rather than samples, so that more views have fewer samples each.
        """
        return replace(
            self,
            views=round(self.views * needs.breadth),
            spp=max(LEAST_SPP, round(self.spp / needs.breadth)),
            gaussians=max(1, round(self.gaussians * needs.gaussians)),
            steps=round(self.steps * needs.breadth**0.5),
            breadth=needs.breadth,
        )

    def in_time(self, share: float) -> Stage:
        """The stage in about some share of its time, or multiple of it.

        In less time, it has fewer new views and steps. In more, it has more samples and steps, not views: in
        the time of 71 frames with 4 samples per pixel, 32 frames with 16 gained 0 to 3 dB more on eight
        scenes. The square of the samples' noise falls as fast as that of what training leaves.
        """
        views, samples = min(share, 1.0), max(share, 1.0) ** 2
        steps = max(1, round(self.steps * share))
        return replace(self, views=round(self.views * views), spp=round(self.spp * samples), steps=steps)


STAGES = (
    Stage(views=32, scale=1, spp=8, gaussians=40_000, steps=150),
    # Displays show whole views in more pixels than the first frames: those of `room` at 512 x 512 gain 3 dB.
    Stage(views=16, scale=2, spp=10, gaussians=47_000, steps=350),
    Stage(views=16, scale=2, spp=32, gaussians=54_000, steps=800),
    # Samples rather than views are lacking by then: 40 views with 32 samples had .3 to .5 dB less after five
    # minutes in three scenes.
    Stage(views=8, scale=2, spp=64, gaussians=74_000, steps=1000),
    Stage(views=60, scale=4, spp=64, gaussians=107_000, steps=1300),
)


# Steps in which what has changed is learnt, and views and steps for another place: first a little, for
# somebody who waits.
_RELEARNT, _NEW_PLACE = (60, 240), ((8, 60), (16, 150))


def places_of(stages: Sequence[Stage]) -> int:
    """Places whose surroundings the views of stages show, one at least."""
    return 1 + sum(stage.opens for stage in stages)


def planned_among(stages: Sequence[Stage]) -> int:
    """Number of the stages that were planned, without extra ones."""
    return sum(not stage.extra for stage in stages)


def going_on(before: Sequence[Stage], is_elsewhere: bool, is_changed: bool) -> list[Stage]:
    """What a preparation does first that goes on from the stages of another one.

    That is to learn what views from elsewhere show, or else what has changed in the frames that there are.
    """
    last, places = before[-1], places_of(before)
    if not is_elsewhere:
        steps_of = _RELEARNT if is_changed else ()
        return [replace(last, views=0, steps=steps, extra=True) for steps in steps_of]
    gaussians = round(last.gaussians * ((places + 1) / places) ** _SURFACES)
    new = replace(last, spp=STAGES[0].spp, gaussians=gaussians, extra=True)
    return [
        replace(new, views=views, steps=steps, opens=number == 0)
        for number, (views, steps) in enumerate(_NEW_PLACE)
    ]


# For somebody who waits for the first frame: as many views as show the border, with few pixels.
FIRST_LOOK = Stage(views=12, scale=0.75, spp=2, gaussians=30_000, steps=60)
# A first look alone, and all stages after one.
GLIMPSE, LIVE = "glimpse", "live"
# Stages by quality.
QUALITIES = {
    GLIMPSE: (FIRST_LOOK,),
    "draft": STAGES[:2],
    "standard": STAGES[:4],
    "high": STAGES,
    LIVE: (FIRST_LOOK, *STAGES),
}


def planned_stage(before: Sequence[Stage], needs: Needs, stages: Sequence[Stage] = STAGES) -> Stage:
    """The stage that follows others, if there is time for all of it."""
    number, places = planned_among(before), places_of(before)
    # More of the same after the last one: the finest frames elsewhere, all samples doubled.
    further = max(0, number - len(stages) + 1)
    stage = stages[min(number, len(stages) - 1)]
    stage = replace(stage, spp=stage.spp * 2**further).for_needs(needs)
    return replace(stage, gaussians=round(stage.gaussians * places**_SURFACES))


MOST_MINUTES = 10_000.0
# A PSNR in dB that may be reached in less than the first stage.
_LITTLE = 30.0


@dataclass(frozen=True)
class PreparationSettings:
    """Settings of a preparation.

    Attributes:
        region: near, reachable, or a file with a camera path (pathtrace.region).
        quality: how far to go, unless minutes or psnr are given: draft, standard or high; glimpse for a
            forest of seconds; live for that and then all that high does.
        minutes: time to use, over 0.
        psnr: dB on held-out views to reach, over 0.
        held_out: number of held-out validation views, which are not trained on and whose time is not counted.
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

    @property
    def stages(self) -> Sequence[Stage]:
        """Stages to do in turn, for the default region of a scene that nobody has looked at."""
        if self.psnr is not None and self.psnr <= _LITTLE:
            return replace(STAGES[0], spp=LEAST_SPP, steps=STAGES[0].steps // 3), *STAGES
        return STAGES if self.minutes is not None or self.psnr is not None else QUALITIES[self.quality]

    def __post_init__(self) -> None:
        as_plain_numbers(self)
        if self.quality not in QUALITIES:
            raise UserError(f"quality {self.quality}: must be {', '.join(QUALITIES)}")
        if self.minutes is not None and not 0 < self.minutes <= MOST_MINUTES:
            raise UserError(f"minutes {self.minutes:g}: must be over 0 and at most {MOST_MINUTES:g}")
        if self.psnr is not None and not 0 < self.psnr < float("inf"):
            raise UserError(f"psnr {self.psnr:g}: must be over 0 dB")
        if self.minutes is not None and self.psnr is not None:
            raise UserError("minutes and psnr: give one of them")
        if self.held_out < 0:
            raise UserError(f"held_out {self.held_out}: must not be negative")
        if self.psnr is not None and not self.held_out:
            raise UserError("psnr and held_out 0: a PSNR can only be reached on held-out views")
        if self.most_indirect is not None and not 0 < self.most_indirect < float("inf"):
            raise UserError(f"most_indirect {self.most_indirect:g}: must be a radiance over 0")
        require_seed(self.seed)
