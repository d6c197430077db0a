"""The answers of compare, diagnose and refine for a lot: frozen data, with the JSON keys of the other answers where they apply.

``error`` is the rms of the whitened residual of the population as its file states it, 1.0 = as predicted; ``refitted`` is that
of the same population with its spreads, patterns and means fitted.  A fitted population always has an error near 1 on the
devices of the fit, because its spreads adapt; the log score and the held-out wafers show what it is worth.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import UNSET, UnsetType

from ..answers import Answer, ByRole


class SpreadAnswer(Answer, frozen=True, eq=False):
    """A random part: its fitted sd over that of the file, with a 90 % interval, and the parts that it stands for.

    ``sd`` : quantity -> fitted sd that the part gives it, rms over the devices [unit of the quantity].
    """

    level: str
    ratio: float
    low: float
    high: float
    members: tuple[str, ...]
    agrees: bool
    sd: Mapping[str, float]


class PatternAnswer(Answer, frozen=True, eq=False):
    """A pattern that all wafers share, over that of the file (0: absent), and its sd."""

    ratio: float
    sd: float


class CalibrationAnswer(Answer, frozen=True, eq=False):
    """Left-out residuals of one quantity: sd (1: calibrated), share inside the central 90 %, p of the PIT's uniformity."""

    sd: float
    inside_90: float
    p_value: float


class PartAnswer(Answer, frozen=True, eq=False):
    """A candidate or a place of misfit: score in sds of its null, p alone and family-wise, share that the fit leaves visible."""

    irregularity: str
    part: str
    z: float
    p_single: float
    p_value: float
    surviving_share: float


class ForecastAnswer(Answer, frozen=True, eq=False):
    """Yield of the held-out wafers: forecast, 90 % interval, as measured, whether it lies inside; number of devices."""

    mean: float
    low: float
    high: float
    measured: float
    inside: bool
    devices: int


class LotOutcomeAnswer(Answer, frozen=True, eq=False):
    """Errors [sd] and log scores [nats a device] by role."""

    error: ByRole
    log_score: ByRole


class LotComparisonAnswer(Answer, frozen=True, eq=False):
    """How well a population explains a lot, and where it fails.

    ``spreads_p_value``, ``means_p_value`` : whether all spreads, and all means and patterns, are those of the file.
    """

    lot: str
    population: str
    devices: int
    held_devices: int
    held_wafers: tuple[str, ...]
    quantities: tuple[str, ...]
    error: ByRole | None
    log_score: ByRole | None
    refitted: LotOutcomeAnswer
    spreads: Mapping[str, SpreadAnswer]
    spreads_p_value: float | None
    means_p_value: float | None
    patterns: Mapping[str, PatternAnswer]
    calibration: Mapping[str, CalibrationAnswer]
    where: tuple[PartAnswer, ...]
    mixtures: Mapping[str, float]
    fit_ok: bool
    as_predicted: bool | None


class LotDiagnosisAnswer(Answer, frozen=True, eq=False):
    """What a population lacks: verdict "adequate", "effect", "class", "unknown" or "fit_failed"."""

    verdict: str
    irregularities: tuple[str, ...]
    candidates: tuple[PartAnswer, ...]
    classes: tuple[tuple[str, ...], ...]
    invisible: tuple[str, ...]
    unexplained: tuple[PartAnswer, ...]
    error: ByRole | None
    separating: Mapping[str, str]


class LotRungAnswer(Answer, frozen=True, eq=False):
    """One model: what was added, held-out confirmation, errors, log scores, fall of the deviance, yield forecast."""

    irregularity: str | None
    status: str | None
    model: str
    error_fit: float
    error_validate: float | None
    log_score_fit: float
    log_score_validate: float | None
    delta_deviance: float
    forecast: ForecastAnswer | None


class LotRefinementAnswer(Answer, frozen=True, eq=False):
    """The ladder, its verdict, and the fitted spreads of the last rung."""

    ladder: tuple[LotRungAnswer, ...]
    verdict: str
    irregularities: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    candidates_left: tuple[PartAnswer, ...]
    unexplained: tuple[PartAnswer, ...]
    spreads: Mapping[str, SpreadAnswer]
    patterns: Mapping[str, PatternAnswer]
    mixtures: Mapping[str, float]
    population_file: str | UnsetType = UNSET
