"""The separating record of a class: the next experiment that would distinguish its members, with a predicted SNR.

Every experiment that the device and the instrument allow (``experiments``) is predicted by the fit with each member of the
class.  ``criticism.separation`` gives the SNR with which the members are distinguished after all parameters are refitted to
the old and new records.  The best experiment is proposed; if its SNR is not high enough, a longer one is tried.

Shapes: N samples, D drives, S senses, P free parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ... import toml_files as toml
from ...arrays import FloatArray
from ...criticism.announce import announce
from ...criticism.budget import CLEAR_SNR, DETECTABLE_SNR
from ...criticism.separation import Prediction, Separation, separation
from ...criticism.verdict import TermClass
from ...errors import ConfigError, unwritable
from ...experiment.files.readers import write_columns
from ...experiment.record import Record
from ...inference.general.gauss_newton import PATIENCE
from ..campaign.recorded import RecordedProblem
from .experiments import Experiment, experiments
from .predictors import Predictor, changes, in_range, predictor, whitened

#: Durations [s] that are tried where a shorter record does not separate every pair.
_LONGER_S = (10.0, 30.0)
#: A longer sweep may gain more than the root of its duration, but hardly by more than this factor.
_GAIN = 2.0
_GIVE_OUT = "give --out DIR to write the drive file"


@dataclass(frozen=True, eq=False)
class Proposal:
    """The best record to separate the members of a class.

    Parameters
    ----------
    members : of the class.
    experiment : excitation and conditions.
    drive_v : (N, D) drive samples [V].
    sample_rate_hz : of the drive samples [Hz].
    separation : predicted SNR of every pair of members.
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
        """The pair to which ``snr`` belongs: the worst that is separated, or the best if none is."""
        reached = [pair for pair in self.separation.pairs if pair[1] >= DETECTABLE_SNR]
        return (reached[0] if reached else self.separation.pairs[-1])[0]

    @property
    def snr(self) -> float:
        """Predicted SNR [sigma] with which ``pair`` is separated."""
        return dict(self.separation.pairs)[self.pair]

    @property
    def separates(self) -> bool:
        """Whether at least one pair is separated, with an SNR of at least ``DETECTABLE_SNR`` [sigma]."""
        return self.snr >= DETECTABLE_SNR

    @property
    def file(self) -> str:
        """Name of the drive file."""
        return f"separating-{'-'.join(self.members)}.parquet"

    def text(self, written: bool = False) -> str:
        """The text of ``separating_record`` in the JSON; it names the drive file only if that was ``written``."""
        if not self.separates:
            if self.snr < 0.01:
                return f"none with this instrument (best: {self.experiment.words}, SNR below 0.01)"
            need = f"an SNR of {DETECTABLE_SNR:g} needs {DETECTABLE_SNR / self.snr:.2g} times less noise, or a stronger effect"
            return f"none with this instrument (best: {self.experiment.words}, SNR {self.snr:.2g}; {need})"
        text = f"{self.experiment.words}: predicted SNR {self.snr:.3g}"
        if len(self.separation.pairs) > 1:
            text += f" for {' against '.join(self.pair)}"
            missed = [" from ".join(pair) for pair, snr in self.separation.pairs if snr < DETECTABLE_SNR]
            text += f"; it does not separate {', '.join(missed)}" if missed else ", more for the other pairs"
        return f"{self.file}: {text}" if written else f"{text} ({_GIVE_OUT})"

    def stanza(self) -> str:
        """The lines for campaign.toml, with comments on how to measure the record."""
        head = [
            f"# {self.text(written=True)}",
            f"# Play the drive columns at {self.sample_rate_hz:g} Hz (hold {self.hold!r}), starting at rest.  Add the measured",
            "# samples as columns sense1_V, ..; put the file beside campaign.toml, add the lines below to it, diagnose again.",
        ]
        # The file has the standard columns, whatever those of the campaign are.
        keys = {"file": self.file, "kind": "time", "role": "fit", "columns": {}}
        conditions = {"rate_dps": self.experiment.rate_dps, "bias_v": self.experiment.bias_v}
        return "\n".join(head) + "\n" + toml.table("[[record]]", {**keys, **conditions})

    def write(self, folder: Path) -> Path | None:
        """Write the drive file and, beside it, the lines for campaign.toml; write nothing if no pair is separated.

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
            raise unwritable("the lines for campaign.toml", folder, error) from None
        return path


@dataclass(frozen=True, eq=False)
class _RecordTrial:
    """An experiment within the range of the converter, its record, the prediction of each member, and its separation.

    ``signals`` are (N S,) in sigmas; ``found`` is exact, or an upper bound.
    """

    experiment: Experiment
    record: Record
    signals: tuple[FloatArray, ...]
    found: Separation

    @property
    def merit(self) -> tuple[float, float]:
        """Number of separated pairs; then the SNR of the best pair that is not separated, or of the worst if all are."""
        left = [snr for _, snr in self.found.pairs if snr < DETECTABLE_SNR]
        return float(self.found.apart(DETECTABLE_SNR)), left[-1] if left else self.found.least


def separating_record(problem: RecordedProblem, terms: Sequence[str], found: TermClass) -> Proposal | None:
    """The record that would separate the members of a class.

    ``None`` if fewer than two of them can be fitted, or if no record is driven: what a drive would do is not known then.

    Parameters
    ----------
    problem : the campaign, with its fits.
    terms : effects in the fit at which the class was found.
    found : the class.
    """
    if not any(np.any(record.drive_v) for record in problem.campaign.with_role("fit")):
        return None
    announce(f"looking for a record that separates {', '.join(found.members)}")
    members = [m for term in found.members if (m := _member(problem, terms, found.term, term)) is not None]
    if len(members) < 2:
        return None
    names = tuple(m.name for m in members)
    first = members[0].fitted
    tried = experiments(problem.campaign, first.model, first.values, names)
    bounds = [trial for one in tried if (trial := _bounded(problem, members, one)) is not None]
    best = _best(problem, members, bounds, None)
    for duration in _LONGER_S:
        if best is None or best.found.least >= CLEAR_SNR:
            break
        longer = duration / best.experiment.excitation.duration_s
        if longer > 1.0 and _GAIN * np.sqrt(longer) * best.merit[1] >= DETECTABLE_SNR:
            slower = _bounded(problem, members, best.experiment.lasting(duration))
            best = _best(problem, members, [] if slower is None else [slower], best)
    if best is None:
        return None
    forces = any(effect.force is not None for m in members for effect in m.fitted.model.ordered_effects())
    if forces and best.found.least < CLEAR_SNR:
        best = _separated(problem, members, best, exact=True)
    hold = problem.campaign.instrument.hold
    return Proposal(names, best.experiment, best.record.drive_v, best.record.sample_rate_hz, best.found, hold)


def _best(
    problem: RecordedProblem, members: Sequence[Predictor], bounds: Sequence[_RecordTrial], best: _RecordTrial | None
) -> _RecordTrial | None:
    """The best of some experiments and ``best``; an experiment whose bound is no better needs no derivatives."""
    for bound in sorted(bounds, key=lambda trial: trial.merit, reverse=True)[:PATIENCE]:
        if best is not None and (bound.merit <= best.merit or best.found.least >= CLEAR_SNR):
            break
        trial = _separated(problem, members, bound)
        if best is None or trial.merit > best.merit:
            best = trial
    return best


def _member(problem: RecordedProblem, terms: Sequence[str], term: str, rival: str) -> Predictor | None:
    """The fit in which ``rival`` replaces ``term``; ``None`` if it fails."""
    swapped = tuple(rival if name == term else name for name in terms)
    fit = problem.fit(swapped, None if rival == term else problem.fit(tuple(terms)))
    return predictor(problem, fit, rival) if fit.ok else None


def _bounded(problem: RecordedProblem, members: Sequence[Predictor], experiment: Experiment) -> _RecordTrial | None:
    """An upper bound on the separation of an experiment; ``None`` if a member cannot exist at its conditions."""
    try:
        reached = in_range(problem.campaign, members, experiment)
    except ConfigError:
        return None
    if reached is None:
        return None
    usable, record, responses = reached
    signals = tuple(whitened(problem, member, record, y[:, :, None])[:, 0] for member, y in zip(members, responses))
    found = separation([Prediction(m.name, s, m.chi2, m.known) for m, s in zip(members, signals)])
    return _RecordTrial(usable, record, signals, found)


def _separated(
    problem: RecordedProblem, members: Sequence[Predictor], trial: _RecordTrial, exact: bool = False
) -> _RecordTrial:
    """The trial with its separation after all parameters are refitted."""
    predictions = [
        Prediction(m.name, signal, m.chi2, m.known, changes(problem, m, trial.record, exact))
        for m, signal in zip(members, trial.signals)
    ]
    return replace(trial, found=separation(predictions))
