"""Kinds of campaigns of the hidden-effects study."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .truth import OUTSIDE

Noise = Literal["white", "coloured", "heavy-tailed", "louder"]


@dataclass(frozen=True)
class HiddenKind:
    """A kind of campaign: number of campaigns in the whole study, range of the SNR, noise, records as on a bench, lone.

    A ``lone`` campaign has two chirp records and nothing that measures its noise: no silence, no repeats, nothing held out.
    """

    campaigns: int
    meaning: str
    snr: tuple[float, float] = (10.0, 1000.0)
    noise: Noise = "white"
    bench: bool = False
    lone: bool = False


KINDS: dict[str, HiddenKind] = {
    "none": HiddenKind(500, "nothing hidden"),
    "one": HiddenKind(220, "one library effect"),
    "weak": HiddenKind(110, "one library effect, weak", (4.0, 10.0)),
    "outside": HiddenKind(9 * len(OUTSIDE), "one effect outside the library"),
    "left-out": HiddenKind(66, "one library effect, removed from the library"),
    "two": HiddenKind(60, "two library effects"),
    "coloured": HiddenKind(60, "nothing hidden, coloured noise", noise="coloured"),
    "heavy-tailed": HiddenKind(60, "nothing hidden, Student's t noise with 4 degrees of freedom", noise="heavy-tailed"),
    "louder": HiddenKind(60, "nothing hidden, noise 20 % stronger in the driven records", noise="louder"),
    "bench-none": HiddenKind(300, "nothing hidden, records that differ as on a bench", bench=True),
    "bench-one": HiddenKind(220, "one library effect, records that differ as on a bench", bench=True),
    "bench-foreign": HiddenKind(120, "one effect outside the library or left out, records that differ", bench=True),
    "lone-none": HiddenKind(100, "nothing hidden, two chirp records alone", lone=True),
    "lone-one": HiddenKind(100, "one library effect, two chirp records alone", lone=True),
    "lone-foreign": HiddenKind(60, "one effect outside the library or left out, two chirp records alone", lone=True),
}
#: Records of a lone campaign: both drives at once as in the paper, with a second sweep in the other direction; or one by one.
LONE = (("chirp", "chirp-swapped"), ("drive1-alone", "drive2-alone"))
