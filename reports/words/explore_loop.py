"""What the interactive page of a campaign or a lot says beside the words of compare, diagnose and refine."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.criticism.budget import CLEAR_SNR, DETECTABLE_SNR
from pipeline.criticism.fit_tests import RefitTest
from pipeline.learning.answers import CandidateAnswer
from pipeline.learning.joint.next_record import RepeatedRecord
from pipeline.learning.next_experiment.predicted import NextRecord

from .campaign import effect_words
from .numbers import number
from .quantities import listed, p_words

WAITING = "Waiting for the work before."
READY = "Ready."
DEFECT = "internal error"
JUDGING = "is judged"
REFUSED = "refused"
NO_NEXT = "A modal record holds poles and residues: nothing says how the next record would be measured."
NO_DRIVE = "What a drive would do is not known from records without one, so no next record is predicted."
NO_RECORDS = (
    "This measurement has no samples, sweeps or decays to draw. What compare says below tells where the model fails."
)
NO_SPECTRUM = "The amplitudes of a decay have no spectrum: they are drawn by time and by level."


def band_words(kind: str, band_hz: tuple[float, float], centres_hz: Sequence[float]) -> str:
    """A band of a spectrum: of the drive, around resonances, or all of it."""
    if kind == "resonance":
        return f"around {listed([number(one) for one in centres_hz])} Hz"
    span = f"{number(band_hz[0], 3)} to {number(band_hz[1])} Hz"
    return f"band of the drive, {span}" if kind == "drive" else f"full band, {span}"


def candidate_words(one: CandidateAnswer) -> str:
    """A candidate in a list: its name and its score."""
    return f"{effect_words(one.effect)}: Δχ² {number(one.delta_chi2, 3)}, p {p_words(one.p_value)}"


def judged_sentence(effect: str, test: RefitTest) -> str:
    """Why refine would not add an effect; "" where it would."""
    if test.outcome == "accepted":
        return ""
    return f"Refine would not add {effect_words(effect)}: {test.reason}."


def next_record_sentences(found: NextRecord | RepeatedRecord, asked_v: float) -> list[str]:
    """How far apart the models without and with an effect are, by the records so far and with the next one."""
    name = effect_words(found.effect)
    level = found.experiment.level_v
    lowered = (
        [f"The level is lowered from {number(asked_v, 3)} V to {number(level, 3)} V: the converter cannot read more."]
        if level < 0.999 * asked_v
        else []
    )
    return [
        f"The records so far separate the models without and with {name} by {number(found.known, 3)} σ.",
        f"Together with the next record ({found.experiment.words}) they separate them by {number(found.snr, 3)} ± 1 σ, with all "
        "parameters refitted. The ± is the noise of the records; the fitted size of the effect counts as exact.",
        f"Without a refit, the two predictions of that record are {number(found.apart, 3)} σ apart.",
        separated_sentence(found.snr),
        *lowered,
    ]


def separated_sentence(snr: float) -> str:
    """What a separation [sigma] is worth."""
    if snr >= CLEAR_SNR:
        return f"Above {CLEAR_SNR:g} σ no other support is needed."
    if snr >= DETECTABLE_SNR:
        return f"From {DETECTABLE_SNR:g} σ on, nine of ten such records show the effect."
    return f"Below {DETECTABLE_SNR:g} σ such a record is likely not to show the effect."


def campaign_lead(name: str, plant: str, effects: Sequence[str]) -> str:
    """What the page of a campaign starts from."""
    own = f" with {listed([effect_words(one) for one in effects])}" if effects else ", no effects"
    return f"Measurement {name}. The given model: plant {plant}{own}. Nothing is written."
