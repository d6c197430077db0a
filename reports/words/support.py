"""What stands beside the ladder, in words: how strongly held-out data support an effect, and which limits judge."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .numbers import number

if TYPE_CHECKING:
    from pipeline.learning.answers import RungAnswer

#: Where the shipped limits are those of another gyro.
NO_LIMITS = (
    "no verdict on the device: the shipped limits are for gyros of 400 to 700 Hz; give others with --limits FILE"
)
#: The held-out chi2 must fall by more than this many sds of the paired difference.
CONFIRMS = 2.0


def support_words(rung: RungAnswer) -> str:
    """ "held out: 1.3 sd"; why a rung with more than 2 sd is partial all the same; "" on the first rung."""
    if rung.status is None:
        return ""
    if rung.held_out_fall is None or not rung.held_out_sd:
        return "nothing was held out"
    sds = rung.held_out_fall / rung.held_out_sd
    text = f"held out: {number(sds, 2)} sd"
    if rung.status == "confirmed":
        return text
    return (
        f"{text}, {CONFIRMS:g} would confirm it" if sds <= CONFIRMS else f"{text}, but the last model is not adequate"
    )
