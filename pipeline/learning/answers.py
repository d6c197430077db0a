"""The answers of compare, diagnose and refine: frozen data, the same types for campaigns and modal records.

JSON keys are the field names, except ``from_`` ("from") and ``class_`` ("class"); ``to_json`` writes them.  A field that is
``UNSET`` has no key: it does not apply to this kind of measurement.  ``None`` (null) means "applies, but is not known".

    Measured    (value, sd); sd is None where the data do not determine it
    Values      parameter name -> Measured
    ByRole      "fit" and "validate" -> value; relative errors of a modal ladder have "before" and "after" instead

Long because the JSON contract of the three commands is in one place.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec import UNSET, Struct, UnsetType

from ..plain import plain

Measured = tuple[float | None, float | None]
Values = Mapping[str, Measured]
ByRole = Mapping[str, float | None]


class Answer(Struct, frozen=True, eq=False):
    """Base of all answers: frozen, fields by name."""


class Noise(Answer, frozen=True, eq=False, rename={"from_": "from"}):
    """Noise level ``sigma`` [V] by channel, where it comes from, and its unit where that is not volts.

    coloured : whether the silence showed a spectrum that is not white.
    jitter_s, gain_noise : rms timing jitter [s] and relative gain noise [1], where the residual above the signal band shows it.
    parts : domain -> noise level [V] by channel, where a campaign has records of several domains.
    local_fit : whether a smooth local fit of the response to the driven records measures it; else "residual" is a bound.
    """

    sigma: tuple[float, ...]
    from_: str
    unit: str | UnsetType = UNSET
    coloured: bool | UnsetType = UNSET
    jitter_s: float | UnsetType = UNSET
    gain_noise: float | UnsetType = UNSET
    local_fit: bool | UnsetType = UNSET
    parts: Mapping[str, tuple[float, ...]] | UnsetType = UNSET


class Deviation(Answer, frozen=True, eq=False):
    """Estimated deviations of one record: relative frequency [1], start [s], gain of each channel [1], ramp [V]."""

    frequency: Measured
    start_s: Measured
    gain: tuple[Measured, ...]
    ramp_v: tuple[Measured, ...]


class RecordsDiffer(Answer, frozen=True, eq=False):
    """How the records of a campaign differ: the spread of each kind (0: not needed), the deviations, and sentences."""

    spread: Mapping[str, float]
    records: Mapping[str, Deviation]
    text: tuple[str, ...]


class BadSamples(Answer, frozen=True, eq=False):
    """A stretch of samples that no fit uses: where, how many, and why ("spike", "stuck", "dropout", "full_scale")."""

    record: str
    channel: str
    time_s: tuple[float, float]
    samples: int
    reason: str


class JumpRows(Answer, frozen=True, eq=False):
    """Neighbouring rows of a sweep beside a jump of the response, which no fit uses: their frequencies and their number."""

    record: str
    band_hz: tuple[float, float]
    rows: int


class Place(Answer, frozen=True, eq=False):
    """A region of the residual, or one entry of a mode, and how badly the model does there.

    Parameters
    ----------
    kind : "resonance", "harmonic", "line", "broadband", "time", "level", "response", "direction", "channel" or "record".
    share : of the misfit in its family.
    error : rms of the residual there [sigma].
    family : regions of one family share out the misfit among them.
    error_after, explained : what the last model of a ladder leaves there, and the share that it explains.
    mode, drive, relative_error, measured, model : entry of a modal record, complex values as (re, im).
    """

    kind: str
    record: str | None
    channel: str | None
    band_hz: tuple[float, float] | None
    share: float
    error: float | None
    family: str | UnsetType = UNSET
    time_s: tuple[float, float] | UnsetType | None = UNSET
    harmonic: int | UnsetType = UNSET
    level: float | str | UnsetType = UNSET
    response_v: tuple[float, float] | UnsetType = UNSET
    direction: str | UnsetType = UNSET
    error_after: float | UnsetType = UNSET
    explained: float | UnsetType = UNSET
    mode: int | UnsetType = UNSET
    drive: str | UnsetType = UNSET
    relative_error: float | UnsetType = UNSET
    measured: tuple[float, float] | UnsetType = UNSET
    model: tuple[float, float] | UnsetType = UNSET


class RecordErrors(Answer, frozen=True, eq=False):
    """Role and errors of one record: ``error`` [sigma], ``error_v`` = rms(measured - model) [V]."""

    role: str
    error: float | None
    error_v: float
    relative_error: float


class ComparisonAnswer(Answer, frozen=True, eq=False):
    """How well a model explains a measurement, and where it fails.

    Parameters
    ----------
    error, relative_error, misfit : by role, [sigma], [1], [sigma].
    where : significant regions.
    where_by_kind : the same with all records and channels together.
    where_rest : the share of each family that is in no significant region.
    where_families : the kinds of each family.
    parameters : of the model.
    bad_samples, jumps : of all records, left out of the fit.
    fit_ok : false where the fit failed; ``why`` gives the reason.
    status, status_reason : of a campaign, as ``identify`` gives them for this model: "ok", "misfit", "fit_failed"; and why.
    device_verdict, device_verdict_reason : pass, fail or undecided by the user's limits, and why; only with limits.
    dof, theta_deg, split_hz, four_thetas_deg, theta_spread_deg : of a modal record.
    """

    error: ByRole
    relative_error: ByRole
    where: tuple[Place, ...]
    parameters: Values
    fit_ok: bool
    why: str | UnsetType = UNSET
    status: str | UnsetType = UNSET
    status_reason: str | UnsetType = UNSET
    device_verdict: str | UnsetType = UNSET
    device_verdict_reason: str | UnsetType = UNSET
    misfit: ByRole | UnsetType = UNSET
    noise: Noise | UnsetType = UNSET
    where_by_kind: tuple[Place, ...] | UnsetType = UNSET
    where_rest: Mapping[str, float] | UnsetType = UNSET
    where_families: Mapping[str, tuple[str, ...]] | UnsetType = UNSET
    records: Mapping[str, RecordErrors] | UnsetType = UNSET
    records_differ: RecordsDiffer | UnsetType = UNSET
    dof: int | UnsetType = UNSET
    theta_deg: Measured | UnsetType = UNSET
    split_hz: Measured | UnsetType = UNSET
    four_thetas_deg: Values | UnsetType = UNSET
    theta_spread_deg: float | UnsetType = UNSET
    bad_samples: tuple[BadSamples, ...] | UnsetType = UNSET
    jumps: tuple[JumpRows, ...] | UnsetType = UNSET


class TermTest(Answer, frozen=True, eq=False):
    """Significance of an absent effect on a modal record: F (or chi2 per degree of freedom), alone and family-wise."""

    effect: str
    F: float
    F_dof: tuple[int, int | None]
    share_of_chi2: float
    p_single: float
    p_value: float


class CandidateAnswer(Answer, frozen=True, eq=False, rename={"class_": "class"}):
    """An absent effect, tested at the given model.

    Parameters
    ----------
    delta_chi2, p_value : fall of chi2 with the effect, family-wise p.
    estimate : its parameters by one Gauss-Newton step.
    error_after : error on the fitted data with the effect in the model.
    class_ : number of its class.
    detectable, snr_at_reach : whether these data could have shown it, and the SNR at the end of its declared range, or where
        it changes the records by as much as they are.
    surviving_share : share of its signature that the model's own parameters do not absorb.
    F, F_dof, share_of_chi2, p_single, relative_error_after : of a modal record.
    """

    effect: str
    delta_chi2: float
    p_value: float
    estimate: Values
    error_after: float | None
    class_: int | None
    detectable: bool
    surviving_share: float
    snr_at_reach: float | None
    F: float | UnsetType = UNSET
    F_dof: tuple[int, int | None] | UnsetType = UNSET
    share_of_chi2: float | UnsetType = UNSET
    p_single: float | UnsetType = UNSET
    relative_error_after: float | UnsetType | None = UNSET


class SizeDisagreement(Answer, frozen=True, eq=False):
    """The partition of the records ("level", "direction" ..) between which the fitted size of an effect differs."""

    by: str
    log_p: float


class PairAnswer(Answer, frozen=True, eq=False):
    """Two absent effects together, on a modal record."""

    effects: tuple[str, ...]
    share_of_chi2: float
    p_value: float


class DiagnosisAnswer(Answer, frozen=True, eq=False):
    """What a model lacks.

    Parameters
    ----------
    verdict : "adequate", "effect", "class", "unknown" or "fit_failed".
    effects : the named effects.
    classes : effects that these data cannot tell apart, where there is more than one.
    invisible : effects and gauge freedoms that these data could not have shown.
    p_left, left : p-value of the structure that is left once the named effects are in, and where it is.
    wrong_form : effects whose fitted size differs between records.
    why : the reason of "fit_failed".
    imitating : effects that leave no misfit together; the verdict is "unknown" because one of them is not supported by itself.
    noise_louder : error where nothing is missing although the gate of ``identify`` refuses it: the noise of the driven records
        is this many times as loud as measured.
    hints : doubts about the campaign rather than the model.
    bad_samples, jumps : of all records, left out of every fit.
    """

    verdict: str
    effects: tuple[str, ...]
    candidates: tuple[CandidateAnswer, ...]
    classes: tuple[tuple[str, ...], ...]
    invisible: tuple[str, ...]
    error: ByRole
    p_left: float | None
    left: str
    wrong_form: Mapping[str, SizeDisagreement]
    why: str
    separating_record: str | None = None
    imitating: tuple[str, ...] = ()
    device_verdict: str | UnsetType = UNSET
    device_verdict_reason: str | UnsetType = UNSET
    noise_louder: float | UnsetType = UNSET
    hints: tuple[str, ...] | UnsetType = UNSET
    noise: Noise | UnsetType = UNSET
    records_differ: RecordsDiffer | UnsetType = UNSET
    pairs: tuple[PairAnswer, ...] | UnsetType = UNSET
    relative_error: ByRole | UnsetType = UNSET
    dof: int | UnsetType = UNSET
    declared: tuple[str, ...] | UnsetType = UNSET
    bad_samples: tuple[BadSamples, ...] | UnsetType = UNSET
    jumps: tuple[JumpRows, ...] | UnsetType = UNSET


class RungAnswer(Answer, frozen=True, eq=False):
    """One model of the ladder.

    Parameters
    ----------
    effect, status : added on this rung, "confirmed" or "partial"; ``None`` on the first.
    error_fit .. relative_error : of this model.
    delta_chi2 : fall of the fitted chi2 against the rung below.
    explained : share of the first model's excess chi2 that this model explains.
    held_out_fall, held_out_sd : fall of the held-out chi2 and the sd of that paired difference.
    terms, dropped : effects in the model, and those removed for this rung.
    derived : theta and split with this model.
    explained_by_kind, error_v, relative_error_validate : of a campaign.
    verdict, verdict_at_face, verdict_reason : pass, fail or undecided with this model; the same without the gate; why.
    theta_deg .. rivals : of a modal record.
    """

    effect: str | None
    status: str | None
    error_fit: float | None
    error_validate: float | None
    misfit_fit: float | None
    misfit_validate: float | None
    relative_error: float | None
    delta_chi2: float
    explained: float | None
    held_out_fall: float | None
    held_out_sd: float | None
    terms: tuple[str, ...]
    dropped: tuple[str, ...]
    parameters: Values
    derived: Values
    explained_by_kind: Mapping[str, float] | UnsetType = UNSET
    error_v: Mapping[str, float] | UnsetType = UNSET
    relative_error_validate: float | UnsetType | None = UNSET
    verdict: str | UnsetType = UNSET
    verdict_at_face: str | UnsetType = UNSET
    verdict_reason: str | UnsetType = UNSET
    theta_deg: Measured | UnsetType = UNSET
    split_hz: Measured | UnsetType = UNSET
    four_thetas_deg: Values | UnsetType = UNSET
    theta_spread_deg: float | UnsetType = UNSET
    dof: int | UnsetType = UNSET
    F: float | UnsetType = UNSET
    F_dof: tuple[int, int | None] | UnsetType = UNSET
    share_of_chi2: float | UnsetType = UNSET
    p_single: float | UnsetType = UNSET
    p_value: float | UnsetType = UNSET
    rivals: tuple[TermTest, ...] | UnsetType = UNSET


class RefinementAnswer(Answer, frozen=True, eq=False):
    """The ladder and what became of theta, split and the parameters.

    Parameters
    ----------
    refused : effect -> why it was not added although its score was significant.
    not_refitted : those of them that were never refitted, because their score expects too little of the misfit.
    not_tried : effects whose score is significant at the end, but the ladder has the largest number of rungs.
    imitating, noise_louder : as in ``DiagnosisAnswer``, for the last model.
    limits : by which the rungs are judged: "own", "shipped", or "none" for a gyro outside the band that the shipped ones are for.
    regions, regions_by_kind : where the first model failed, with what the last one leaves there.
    relative_error, where, candidates_left, invisible, declared : of a modal record.
    """

    ladder: tuple[RungAnswer, ...]
    verdict: str
    effects: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    wrong_form: Mapping[str, SizeDisagreement]
    refused: Mapping[str, str]
    regions: tuple[Place, ...]
    p_left: float
    left: str
    why: str
    not_refitted: tuple[str, ...] = ()
    not_tried: tuple[str, ...] = ()
    imitating: tuple[str, ...] = ()
    limits: str | UnsetType = UNSET
    noise_louder: float | UnsetType = UNSET
    hints: tuple[str, ...] | UnsetType = UNSET
    separating_record: str | UnsetType | None = UNSET
    regions_by_kind: tuple[Place, ...] | UnsetType = UNSET
    noise: Noise | UnsetType = UNSET
    records_differ: RecordsDiffer | UnsetType = UNSET
    bad_samples: tuple[BadSamples, ...] | UnsetType = UNSET
    jumps: tuple[JumpRows, ...] | UnsetType = UNSET
    theta_before_deg: Measured | UnsetType = UNSET
    split_before_hz: Measured | UnsetType = UNSET
    theta_deg: Measured | UnsetType = UNSET
    split_hz: Measured | UnsetType = UNSET
    parameters: Values | UnsetType = UNSET
    relative_error: ByRole | UnsetType = UNSET
    where: tuple[Place, ...] | UnsetType = UNSET
    candidates_left: tuple[TermTest, ...] | UnsetType = UNSET
    invisible: tuple[str, ...] | UnsetType = UNSET
    declared: tuple[str, ...] | UnsetType = UNSET


def to_builtins(answer: Answer) -> dict[str, Any]:
    """The answer as JSON holds it: keys by name, no key for ``UNSET``, null for numbers that are not finite."""
    found: dict[str, Any] = plain(msgspec.to_builtins(answer, enc_hook=plain))
    return found


def to_json(answer: Answer) -> str:
    """The answer as JSON text."""
    return msgspec.json.encode(to_builtins(answer)).decode()
