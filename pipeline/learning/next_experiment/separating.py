"""The record that would separate the members of a class, as drive samples with a predicted SNR.

Every experiment that device and instrument allow (``separating_experiments``) is predicted by the fit with each member of the
class; ``pipeline.criticism.separation`` says how well they are told apart once all parameters are refitted on old and new
records.  The best is proposed; where it is not sure to do, it is made slower and longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ... import toml_files as toml
from ...arrays import FloatArray
from ...criticism.separation import Prediction, Separation, known_of, separation
from ...criticism.verdict import TermClass
from ...errors import ConfigError, UsageError
from ...experiment.files.readers import write_columns
from ...experiment.forward.record import forward, jacobian
from ...experiment.forward.sensitivity import tuned_steps
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit
from ...inference.general.residuals import nuisance_columns
from ..campaign.problem import CampaignProblem
from .experiments import Experiment, experiments, within

#: SNR from which a record is said to separate, and from which the loop sees it surely and nothing longer is tried.
LEAST, SURE = 5.0, 8.0
#: From here on no better one is looked for; nor after so many with the largest bounds.
_PLENTY, _MOST = 12.0, 8
_LONGER_S = (10.0, 30.0)
#: A slower sweep may gain more than the root of its duration, but hardly by more than this.
_GAIN = 2.0
#: How often a level is lowered until the converter holds the answer.
_LOWERED = 4
_GIVE_OUT = "give --out DIR to have the drive file"


@dataclass(frozen=True, eq=False)
class Proposal:
    """The best record to separate a class.

    Parameters
    ----------
    members : of the class.
    experiment : what to play.
    drive_v : (N, D) [V]; ``sample_rate_hz`` [Hz].
    separation : predicted SNR of every pair.
    hold : of the instrument.
    """

    members: tuple[str, ...]
    experiment: Experiment
    drive_v: FloatArray
    sample_rate_hz: float
    separation: Separation
    hold: str

    @property
    def pair(self) -> tuple[str, str]:
        """The pair that ``snr`` is said of: the worst that is told apart, or the best where none is."""
        reached = [pair for pair in self.separation.pairs if pair[1] >= LEAST]
        return (reached[0] if reached else self.separation.pairs[-1])[0]

    @property
    def snr(self) -> float:
        """Predicted SNR of telling ``pair`` apart."""
        return dict(self.separation.pairs)[self.pair]

    @property
    def separates(self) -> bool:
        """Whether at least one pair is told apart."""
        return self.snr >= LEAST

    @property
    def file(self) -> str:
        """Name of the drive file."""
        return f"separating-{'-'.join(self.members)}.parquet"

    def text(self, written: bool = False) -> str:
        """What ``separating_record`` says; names the file only where it was ``written``."""
        if not self.separates:
            if self.snr < 0.01:
                return f"none with this instrument (best: {self.experiment.words}, SNR below 0.01)"
            need = f"{LEAST:g} needs {LEAST / self.snr:.2g} times less noise, or a stronger effect"
            return f"none with this instrument (best: {self.experiment.words}, SNR {self.snr:.2g}; {need})"
        said = f"{self.experiment.words}: predicted SNR {self.snr:.3g}"
        if len(self.separation.pairs) > 1:
            said += f" for {' against '.join(self.pair)}"
            left = [" from ".join(pair) for pair, snr in self.separation.pairs if snr < LEAST]
            said += f", not enough for {', '.join(left)}" if left else " and more for the others"
        return f"{self.file}: {said}" if written else f"{said} ({_GIVE_OUT})"

    def stanza(self) -> str:
        """The lines for campaign.toml, and how to come by the record."""
        head = [
            f"# {self.text(written=True)}",
            f"# Play the drive columns at {self.sample_rate_hz:g} Hz (hold {self.hold!r}) from rest, add what was measured",
            "# as columns sense1_V, .., put the file beside campaign.toml with the lines below, and diagnose again.",
        ]
        conditions = {"rate_dps": self.experiment.rate_dps, "bias_v": self.experiment.bias_v}
        return "\n".join(head) + "\n" + toml.table("[[record]]", {"file": self.file, "role": "fit", **conditions})

    def write(self, folder: Path) -> Path | None:
        """The drive file and, beside it, the lines for campaign.toml; nothing where nothing separates.

        Raises
        ------
        UsageError : the folder cannot be written.
        """
        if not self.separates:
            return None
        columns = {"time_s": np.arange(self.drive_v.shape[0]) / self.sample_rate_hz}
        columns |= {f"drive{k + 1}_V": np.ascontiguousarray(v) for k, v in enumerate(self.drive_v.T)}
        path = write_columns(folder, self.file.removesuffix(".parquet"), columns, "parquet")
        try:
            path.with_suffix(".toml").write_text(self.stanza(), encoding="utf-8")
        except OSError as error:
            raise UsageError(f"cannot write beside the drive file ({error.strerror})", value=str(folder)) from None
        return path


@dataclass(frozen=True, eq=False)
class _Member:
    """The fit with one member in place, what the old records say of it, d values / d coordinates, and steps of differences."""

    term: str
    fitted: CampaignFit
    chi2: float
    known: FloatArray
    turn: FloatArray
    steps: FloatArray


@dataclass(frozen=True, eq=False)
class _Trial:
    """An experiment at a level that the converter allows, what each member would answer (in sigmas), and what it would tell
    (or a bound on it)."""

    experiment: Experiment
    record: Record
    signals: tuple[FloatArray, ...]
    found: Separation

    @property
    def merit(self) -> tuple[float, float]:
        """More pairs told apart; then the best of those that are not yet, or the worst where all are."""
        left = [snr for _, snr in self.found.pairs if snr < LEAST]
        return float(self.found.apart(LEAST)), left[-1] if left else self.found.least


def proposals(view: CampaignProblem, terms: Sequence[str], classes: Sequence[TermClass]) -> tuple[Proposal, ...]:
    """The separating record of every class of more than one member."""
    found = (separating_record(view, terms, one) for one in classes if len(one.members) > 1)
    return tuple(one for one in found if one is not None)


def separating_text(found: Sequence[Proposal], written: bool) -> str | None:
    """``separating_record`` of the JSON: one text, ``None`` where there is no class."""
    if len(found) == 1:
        return found[0].text(written)
    return "; ".join(f"{' or '.join(one.members)}: {one.text(written)}" for one in found) or None


def separating_record(view: CampaignProblem, terms: Sequence[str], found: TermClass) -> Proposal | None:
    """The record that would separate the members of a class; ``None`` where fewer than two could be fitted.

    Parameters
    ----------
    view : the campaign, with its fits.
    terms : in the fit that the class was found at.
    found : the class.
    """
    members = [m for term in found.members if (m := _member(view, terms, found.term, term)) is not None]
    if len(members) < 2:
        return None
    names = tuple(m.term for m in members)
    first = members[0].fitted
    asked = experiments(view.campaign, first.model, first.values, names)
    bounds = [trial for one in asked if (trial := _bounded(view, members, one)) is not None]
    best = _best(view, members, bounds, None)
    for duration in _LONGER_S:
        if best is None or best.found.least >= SURE:
            break
        longer = duration / best.experiment.excitation.duration_s
        if longer > 1.0 and _GAIN * np.sqrt(longer) * best.merit[1] >= LEAST:
            slower = _bounded(view, members, best.experiment.lasting(duration))
            best = _best(view, members, [] if slower is None else [slower], best)
    if best is None:
        return None
    forces = any(effect.force is not None for m in members for effect in m.fitted.model.ordered_effects())
    if forces and best.found.least < _PLENTY:
        best = _told(view, members, best, exact=True)
    hold = view.campaign.instrument.hold
    return Proposal(names, best.experiment, best.record.drive_v, best.record.sample_rate_hz, best.found, hold)


def _best(
    view: CampaignProblem, members: Sequence[_Member], bounds: Sequence[_Trial], best: _Trial | None
) -> _Trial | None:
    """The best of some experiments and ``best``; those whose bound is no better need no derivatives."""
    for bound in sorted(bounds, key=lambda trial: trial.merit, reverse=True)[:_MOST]:
        if best is not None and (bound.merit <= best.merit or best.found.least >= _PLENTY):
            break
        trial = _told(view, members, bound)
        if best is None or trial.merit > best.merit:
            best = trial
    return best


def _member(view: CampaignProblem, terms: Sequence[str], term: str, rival: str) -> _Member | None:
    swapped = tuple(rival if name == term else name for name in terms)
    fit = view.fit(swapped, None if rival == term else view.fit(tuple(terms)))
    if not fit.ok:
        return None
    fitted, campaign = view.campaign_fit(swapped), view.campaign
    plain = replace(campaign.with_role("fit")[0], at_rest=True)
    steps = tuned_steps(fitted.model, fitted.values, plain, campaign.instrument, angular_gain=campaign.angular_gain)
    return _Member(rival, fitted, fit.chi2, known_of(fit), fitted.model.values_jacobian(fitted.x), steps)


def _bounded(view: CampaignProblem, members: Sequence[_Member], experiment: Experiment) -> _Trial | None:
    """A bound on what an experiment would tell; ``None`` where a member cannot be at its conditions."""
    adc = view.campaign.instrument.adc
    try:
        for _ in range(_LOWERED):
            record = experiment.record(view.campaign)
            answers = [_answer(view.campaign, member, record) for member in members]
            lower = within(experiment, max(float(np.max(np.abs(y))) for y in answers), adc)
            if lower is experiment:
                break
            experiment = lower
        else:
            return None
    except ConfigError:
        return None
    signals = tuple(_white(view, member, record, y[:, :, None])[:, 0] for member, y in zip(members, answers))
    found = separation([Prediction(m.term, s, m.chi2, m.known) for m, s in zip(members, signals)])
    return _Trial(experiment, record, signals, found)


def _told(view: CampaignProblem, members: Sequence[_Member], trial: _Trial, exact: bool = False) -> _Trial:
    """What an experiment would tell with all parameters refitted."""
    predictions = [
        Prediction(m.term, signal, m.chi2, m.known, _columns(view, m, trial.record, exact))
        for m, signal in zip(members, trial.signals)
    ]
    return replace(trial, found=separation(predictions))


def _answer(campaign: Campaign, member: _Member, record: Record) -> FloatArray:
    model, values = member.fitted.model, member.fitted.values
    return forward(model, values, record, campaign.instrument, angular_gain=campaign.angular_gain)


def _columns(view: CampaignProblem, member: _Member, record: Record, exact: bool) -> FloatArray:
    """(N S, P) what the parameters of a member's fit move in a new record, in sigmas."""
    fitted, campaign = member.fitted, view.campaign
    columns = jacobian(
        fitted.model,
        fitted.values,
        record,
        campaign.instrument,
        angular_gain=campaign.angular_gain,
        exact=exact,
        steps=member.steps,
    )
    white, free = _white(view, member, record, columns), columns.shape[2]
    # Columns of the old rows beyond the free parameters are initial states of single records.
    wide = np.zeros((white.shape[0], member.known.shape[1]))
    wide[:, :free] = np.linalg.solve(member.turn.T, white.T).T
    return wide


def _white(view: CampaignProblem, member: _Member, record: Record, y: FloatArray) -> FloatArray:
    """Volts (N, S, k) as rows (N S, k) in sigmas, what is free in every record and channel projected out."""
    n = nuisance_columns(member.fitted.model, member.fitted.values, record, view.campaign.instrument)
    white = (y / view.noise.sigma_v[:, None]).reshape(y.shape[0], -1)
    return np.asarray((white - n @ (n.T @ white)).reshape(-1, y.shape[2]))
