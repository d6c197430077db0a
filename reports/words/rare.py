"""Rare losses in words."""

from __future__ import annotations

from ..rare import Driver, Loss, RareLosses, Undecided
from .numbers import number

#: Below a hundredth of a percent, losses are stated in parts per million.
_PPM = 1e-4


def rare_lines(found: RareLosses) -> list[str]:
    """What ``gyroscreen rare`` prints."""
    lines = [line for loss in found.losses for line in _loss_lines(loss, found.drivers[loss.limit])]
    how = "importance sampling" if found.method == "importance" else "plain Monte Carlo"
    return [
        *lines,
        f"{how} with {found.devices} virtual devices, each of a lot and wafer of its own; {found.dimension} latent normals;"
        f" seed {found.seed}",
        "lost: the true value as packaged is beyond the limit; the error of a measurement is not included",
    ]


def _loss_lines(loss: Loss, drivers: tuple[Driver, ...]) -> list[str]:
    name = "any of these limits" if loss.limit == "total" else loss.limit
    interval = f"95 % interval {share_words(loss.low)} to {share_words(loss.high)}"
    shown = f"{share_words(loss.probability)} ({interval}), effectively {number(loss.ess, 3)} lost devices"
    state = "" if loss.undecided is None else f"; undecided: {undecided_words(loss.undecided)}"
    named = ", ".join(f"{one.latent} {one.mean:+.1f} (rms {one.rms:.1f})" for one in drivers)
    return [f"{name}: {shown}{state}", *([f"    lost devices, mean in sd: {named}"] if named else [])]


def share_words(share: float) -> str:
    """A share in percent, or in ppm where it is small."""
    return f"{number(1e6 * share, 3)} ppm" if 0.0 < share < _PPM else f"{number(100.0 * share, 3)} %"


def undecided_words(why: Undecided) -> str:
    """Why a loss is undecided, and what to do."""
    value = share_words(why.value)
    return {
        "not_found": f"the search ended at a probability of {value} without a lost device; raise sampling.devices, or the loss is"
        " below that",
        "plateau": f"at a probability of {value} the quantity no longer changes towards the limit; use sampling.method = 'plain'",
        "disagreement": f"subset simulation gives {value}: a region of loss may be missing; raise sampling.devices or change"
        " the seed",
        "few": f"only {number(why.value, 2)} effective lost devices; raise sampling.devices",
        "wide": f"the interval is +-{number(100.0 * why.value, 2)} % wide; raise sampling.devices or sampling.precision",
        "none": "no device was lost; raise sampling.devices",
    }[why.reason]
