"""Sentences about the records of a campaign: how they differ, and which of their rows no fit uses."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.learning.answers import BadSamples, ComparisonAnswer, DiagnosisAnswer, JumpRows, RefinementAnswer

from .quantities import listed

BAD_WORDS = {"spike": "spikes", "stuck": "stuck samples", "dropout": "dropouts", "full_scale": "the ADC at full scale"}


def record_sentences(answer: ComparisonAnswer | DiagnosisAnswer | RefinementAnswer) -> list[str]:
    """How the records differ, where their variation was found and removed; which samples were left out."""
    differ = answer.records_differ
    found = [] if not differ else [f"The records differ, and the fit allows for it. {' '.join(differ.text)}"]
    found += [bad_samples_sentence(answer.bad_samples)] if answer.bad_samples else []
    return [*found, jumps_sentence(answer.jumps)] if answer.jumps else found


def jumps_sentence(found: Sequence[JumpRows]) -> str:
    """Which rows of sweeps were left out of every fit, and why."""
    middles = sorted({f"{0.5 * sum(one.band_hz):.6g}" for one in found}, key=float)
    count = sum(one.rows for one in found)
    return (
        f"{count} rows of the sweeps are left out of every fit: the response jumps there, and the motion does not settle within "
        f"a row (near {listed(middles)} Hz)."
    )


def bad_samples_sentence(found: Sequence[BadSamples]) -> str:
    """How many samples of which records were left out of every fit, and why."""
    records = listed(list(dict.fromkeys(one.record for one in found)))
    reasons = listed([BAD_WORDS.get(name, name) for name in dict.fromkeys(one.reason for one in found)])
    count = sum(one.samples for one in found)
    are = "samples are" if count > 1 else "sample is"
    return f"{count} bad {are} left out of every fit ({reasons} in {records}). Check cables, connectors and the logger."
