"""A campaign as criticism sees it: blocks of whitened Fourier coefficients, jacobian, signatures, probes, regions.

A record of N samples becomes, channel by channel, the coefficients sqrt(2/N) (Re, Im) Y(w)/sigma of the bins above zero up to
``TOP_HZ`` (a unitary picture of that part of the data; the bin at zero is the free offset).  Lines and transients that are
free in a record are projected out before.

Shapes: N samples, S senses, F bins; rows of a block 2 F, columns S.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.fft import rfft

from pipeline.arrays import FloatArray, IntArray
from pipeline.criticism.problem import (
    Block,
    Candidate,
    FitResult,
    LocalCandidate,
    Region,
    Signatures,
    TermParameter,
)
from pipeline.device.effect import Effect
from pipeline.device.model import Model
from pipeline.device.parameters import Parameter
from pipeline.errors import ConfigError, GyroscreenError
from pipeline.experiment.forward import Signature, jacobian, signatures
from pipeline.experiment.lines import lines_removed, without_lines
from pipeline.experiment.noise_level import NoiseLevel
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.campaign_fit import CampaignFit, fit_campaign
from pipeline.inference.campaign_problem import Problem, nuisance_columns

from .campaign_plane import Plane, planes_of
from .campaign_regions import regions_of

#: Above this every effect of the library is as good as silent for drives below 700 Hz.
TOP_HZ = 2500.0
#: Grid of the parasitic mode's signature: the driven band and a little beyond it.
_GRID: dict[str, dict[str, tuple[float, ...]]] = {
    "parasitic_mode": {"f": tuple(320.0 * 1.04**k for k in range(22)), "zeta": (1e-2,)}
}
#: Clip levels that are scanned, as shares of the largest sample.
_LEVELS = (1.0, 0.997, 0.99, 0.97, 0.93, 0.85, 0.7)
#: A direction enters as (cos a, sin a), so two of them span all.
_AXES_DEG = (0.0, 90.0)
#: Share of a record made by forces and pick-off laws from which the plant's columns are computed with them.
_STRONG = 0.1
_STRATA_HZ = (0.0, 350.0, 750.0, 1500.0)


@dataclass(frozen=True, eq=False)
class Spectra:
    """Which bins of a record count, and how they are scaled."""

    samples: int
    bins: IntArray
    frequency_hz: FloatArray

    def __call__(self, y: FloatArray) -> FloatArray:
        """(N, S, ...) -> (2 F, S, ...): unitary real Fourier coefficients."""
        # Along the last, contiguous axis a transform is several times faster than down a column.
        c = rfft(np.ascontiguousarray(y.reshape(y.shape[0], -1).T), axis=-1)[:, self.bins] * np.sqrt(2.0 / self.samples)
        return np.concatenate([c.real, c.imag], axis=1).T.reshape(-1, *y.shape[1:])


def spectra_of(record: Record) -> Spectra:
    """Bins above zero, up to ``TOP_HZ`` and below Nyquist."""
    n, rate = record.drive_v.shape[0], record.sample_rate_hz
    bins = np.arange(1, (n - 1) // 2 + 1)
    frequency = bins * rate / n
    kept = frequency <= TOP_HZ
    return Spectra(n, bins[kept], frequency[kept])


class CampaignView:
    """The ``Problem`` of one campaign; fits and signatures are kept, for they are asked for again."""

    def __init__(self, campaign: Campaign, model: Model, noise: NoiseLevel) -> None:
        self.campaign = campaign
        self.noise = noise
        first = campaign.with_role("fit")[0]
        self.model = model.with_channels(first.sense_v.shape[1], first.drive_v.shape[1])
        self.records = campaign.with_role("fit")
        self._fits: dict[frozenset[str], tuple[CampaignFit, FitResult]] = {}
        self._bases: dict[tuple[str, tuple[str, ...]], FloatArray] = {}
        self._signatures: dict[str, tuple[Candidate, tuple[FloatArray, ...]] | None] = {}

    @cached_property
    def spectra(self) -> tuple[Spectra, ...]:
        """One a fit record."""
        return tuple(spectra_of(record) for record in self.records)

    def campaign_fit(self, terms: Sequence[str]) -> CampaignFit:
        """The fit of the model with these terms, made before."""
        return self._fits[frozenset(terms)][0]

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """Fit the model with these terms."""
        key = frozenset(terms)
        if key not in self._fits:
            model = self.model
            for term in terms:
                model = model.with_effect(term)
            begun = None if start is None else {name: value for name, (value, _) in start.parameters.items()}
            try:
                fitted = fit_campaign(model, self.campaign, self.noise, begun)
                self._fits[key] = (fitted, self._result(fitted, terms))
            except (GyroscreenError, np.linalg.LinAlgError) as error:
                return FitResult(False, terms, {}, (), (), why=str(error))
        return self._fits[key][1]

    def _result(self, fitted: CampaignFit, terms: tuple[str, ...]) -> FitResult:
        turn = _external(fitted)
        jacobians = []
        starts = []
        problem = Problem(fitted.model, self.campaign, self.noise.sigma_v)
        for record, spectra in zip(self.records, self.spectra):
            task, start = problem.task(record, fitted.values), self._start(fitted, record)
            exact = problem.strength(fitted.values, task) > _STRONG
            j = jacobian(
                fitted.model,
                fitted.values,
                record,
                self.campaign.instrument,
                angular_gain=self.campaign.angular_gain,
                start=start,
                exact=exact,
            )
            jacobians.append(self._rows(fitted, record, spectra, j) @ turn)
            if start is None:
                starts.append(np.zeros((jacobians[-1].shape[0], 0)))
            else:
                f = problem.start_columns(fitted.values, task, start, exact)
                starts.append(spectra(f.reshape(*record.sense_v.shape, -1)).reshape(-1, start.size))
        jacobians = [np.concatenate(parts, axis=1) for parts in zip(jacobians, _block_diagonal(starts))]
        free = fitted.model.free
        columns = {
            term: tuple(i for i, name in enumerate(free) if name.startswith(f"{term}.") or _is_quantity(term, name))
            for term in terms
        }
        shifts = {
            term: tuple(
                0.0 if (p := fitted.model.by_name[free[i]]).grid else fitted.values[free[i]] - p.null
                for i in columns[term]
            )
            for term in terms
        }
        derived = {}
        if fitted.theta_deg is not None and fitted.split_hz is not None:
            derived = {"theta_deg": fitted.theta_deg, "split_hz": fitted.split_hz}
        known = self.noise.source != "local"
        blocks = tuple(self._block(record, fitted) for record in self.records)
        held = tuple(self._block(record, fitted) for record in self.campaign.with_role("validate"))
        return FitResult(
            fitted.fit_ok or bool(np.isfinite(fitted.chi2)),
            terms,
            fitted.parameters,
            blocks,
            tuple(jacobians),
            derived=derived,
            held=held,
            columns=columns,
            shifts=shifts,
            strata=tuple(
                _strata(spectra, record.sense_v.shape[1]) for record, spectra in zip(self.records, self.spectra)
            ),
            noise_known=known,
            error={k: v for k, v in fitted.error.items() if v is not None and known},
            relative_error={k: v for k, v in fitted.relative_error.items() if v is not None},
        )

    def _start(self, fitted: CampaignFit, record: Record) -> FloatArray | None:
        """Fitted initial state of a record that does not start at rest."""
        return next(r for r in fitted.records if r.name == record.name).start

    def _rows(self, fitted: CampaignFit, record: Record, spectra: Spectra, y: FloatArray) -> FloatArray:
        """Volts (N, S, K) as whitened rows (2 F S, K), the record's own free amplitudes projected out."""
        n = self._nuisances(fitted, record)
        white = y / self.noise.sigma_v[:, None]
        if n.shape[1] > 1:  # the offset alone is the bin at zero, which is left out anyway
            flat = white.reshape(y.shape[0], -1)
            white = (flat - n @ (n.T @ flat)).reshape(y.shape)
        return spectra(white).reshape(-1, y.shape[2])

    def _nuisances(self, fitted: CampaignFit, record: Record) -> FloatArray:
        """Orthonormal basis of a record's free amplitudes; it depends on the effects of the model alone."""
        key = (record.name, fitted.model.effects)
        if key not in self._bases:
            self._bases[key] = nuisance_columns(fitted.model, fitted.values, record, self.campaign.instrument)
        return self._bases[key]

    def _block(self, record: Record, fitted: CampaignFit) -> Block:
        mine = next(r for r in fitted.records if r.name == record.name)
        twins = [r.name for r in self.campaign.records if r.role == record.role and _same_drive(r, record)]
        return Block(
            record.name,
            spectra_of(record)(mine.residual),
            labels_of(record, self.campaign),
            repeat=twins[0] if len(twins) > 1 else None,
            nuisances=0,
        )

    def signatures(self, fit: FitResult) -> Signatures:
        """Signatures of all absent effects; those found at an earlier fit serve again, for they hardly change."""
        fitted = self.campaign_fit(fit.terms)
        candidates: list[Candidate] = []
        parts: list[list[FloatArray]] = [[] for _ in self.records]
        local: list[LocalCandidate] = []
        offset = 0
        for name in fitted.model.candidates():
            effect = fitted.model.library[name]
            if effect.disturbance is not None:
                local.append(self._lines(fitted, name))
                continue
            if name not in self._signatures:
                self._signatures[name] = self._signature(fitted, name)
            found = self._signatures[name]
            if found is None:
                continue
            candidate, columns = found
            cells = tuple(slice(c.start + offset, c.stop + offset) for c in candidate.cells)
            candidates.append(Candidate(candidate.name, candidate.parameters, cells, candidate.grid))
            for part, own in zip(parts, columns):
                part.append(own)
            offset += columns[0].shape[1]
        rows = [j.shape[0] for j in fit.jacobian]
        blocks = tuple(np.concatenate(part, axis=1) if part else np.zeros((n, 0)) for part, n in zip(parts, rows))
        return Signatures(tuple(candidates), blocks, tuple(local))

    def _signature(self, fitted: CampaignFit, name: str) -> tuple[Candidate, tuple[FloatArray, ...]] | None:
        effect = fitted.model.library[name]
        members = effect.members(self.model.built.shape)
        turned = next((m.name for m in members if m.per == "direction" or (m.name == "a" and m.grid)), None)
        grid = dict(_GRID.get(name, {}))
        if turned is not None and len(members) > 1:
            grid[turned] = _AXES_DEG
        if effect.stages == ("adc",) and len(members) == 1:
            # A clip level above all samples changes nothing, and one far below them would be plain to see.
            peak = max(float(np.max(np.abs(record.sense_v))) for record in self.records)
            grid[members[0].name] = tuple(1.0 / (peak * share) for share in _LEVELS)
        by_record = []
        made: dict[bytes, Any] = {}
        hints: dict[str, float] = {}
        for record, spectra in zip(self.records, self.spectra):
            # Records with the same drive and conditions have the same signature.
            start = self._start(fitted, record)
            key = record.drive_v.tobytes() + repr((record.rate_dps, record.bias_v, start)).encode()
            if key not in made:
                try:
                    found = signatures(
                        fitted.model,
                        fitted.values,
                        record,
                        self.campaign.instrument,
                        name,
                        angular_gain=self.campaign.angular_gain,
                        start=start,
                        grid=grid or None,
                        step_hints=hints,
                    )
                except ConfigError:
                    return None
                hints = found[-1].steps
                made[key] = (found, [self._rows(fitted, record, spectra, s.columns) for s in found])
            by_record.append(made[key])
        return _candidate(effect, members, by_record[0][0], turned), tuple(
            np.concatenate(rows, axis=1) for _, rows in by_record
        )

    def _lines(self, fitted: CampaignFit, name: str) -> LocalCandidate:
        """Fall of chi2 that free lines bring, for 50 and 60 Hz."""
        falls, dof = [], 0
        grid = ({"f": 50.0}, {"f": 60.0})
        for point in grid:
            fall, spent = 0.0, 0
            for record in self.records:
                mine = next(r for r in fitted.records if r.name == record.name)
                samples, senses = record.sense_v.shape
                left = without_lines(mine.residual, record.sample_rate_hz, point["f"])
                fall += float(np.sum(mine.residual**2) - np.sum(left**2))
                spent += (lines_removed(samples, record.sample_rate_hz, point["f"]) - 1) * senses
            falls.append(fall)
            dof = max(dof, spent)
        return LocalCandidate(name, tuple(falls), dof, grid)

    def probes(self, fit: FitResult) -> Signatures:
        """Shapes that almost any missing physics touches: powers, drifts and cross-talk of the model's own response."""
        fitted = self.campaign_fit(fit.terms)
        blocks = []
        count = 0
        for record, spectra in zip(self.records, self.spectra):
            y = next(r for r in fitted.records if r.name == record.name).predicted_v
            t = np.arange(y.shape[0])[:, None] / record.sample_rate_hz
            slope = np.gradient(y, axis=0)
            shapes = [y * t, y**2, y**3, np.abs(y) * y, y**2 * slope, slope, slope * t, y[:, ::-1], np.sign(y)]
            columns = []
            for shape in shapes:
                for channel in range(y.shape[1]):
                    one = np.zeros_like(y)
                    one[:, channel] = shape[:, channel]
                    columns.append(one)
            blocks.append(self._rows(fitted, record, spectra, np.stack(columns, axis=2)))
            count = len(columns)
        unit = (TermParameter("amplitude"),)
        candidates = tuple(Candidate(f"shape {i}", unit, (slice(i, i + 1),)) for i in range(count))
        return Signatures(candidates, tuple(blocks))

    @cached_property
    def planes(self) -> dict[str, Plane]:
        """How each record is cut, by the first fit that was made: the same cut for all models."""
        return planes_of(self.campaign, self.campaign_fit(tuple(next(iter(self._fits)))))

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """Residual energy of each record and channel by time, resonance, harmonic of the drive and band, up to Nyquist."""
        return regions_of(self.campaign_fit(fit.terms), self.planes)


def _candidate(
    effect: Effect, members: Sequence[Parameter], found: Sequence[Signature], turned: str | None
) -> Candidate:
    """The candidate whose columns are those of ``found``, one after the other; directions of one point share a cell."""
    own = [m for m in members if m.name in found[0].names]
    parameters = [
        TermParameter(
            effect.full_name(m),
            m.unit,
            m.null,
            max(abs(m.high - m.null), abs(m.low - m.null)),
            1 if m.low == m.null else (-1 if m.high == m.null else 0),
        )
        for m in own
    ]
    together = len(_AXES_DEG) if turned is not None and len(found) % len(_AXES_DEG) == 0 and len(found) > 1 else 1
    if together > 1:
        parameters = [replace(p, name=f"{p.name} at {a:g} deg") for a in _AXES_DEG for p in parameters]
    width = len(own) * together
    cells = tuple(slice(i * width, (i + 1) * width) for i in range(len(found) // together))
    grid = tuple({k: float(v) for k, v in s.point.items() if k != turned} for s in found[::together])
    return Candidate(effect.name, tuple(parameters), cells, grid)


def _block_diagonal(parts: Sequence[FloatArray]) -> list[FloatArray]:
    """Columns of single records (n_b, k_b) as columns of all of them (n_b, sum k)."""
    edges = np.cumsum([0, *(part.shape[1] for part in parts)])
    out = []
    for part, first in zip(parts, edges):
        wide = np.zeros((part.shape[0], int(edges[-1])))
        wide[:, first : first + part.shape[1]] = part
        out.append(wide)
    return out


def _is_quantity(term: str, name: str) -> bool:
    return term == "offdiagonal_damping" and name == "c12_per_s"


def _same_drive(a: Record, b: Record) -> bool:
    return a.drive_v.shape == b.drive_v.shape and bool(np.array_equal(a.drive_v, b.drive_v))


def _strata(spectra: Spectra, senses: int) -> IntArray:
    """Noise stratum of each row: band of frequency and channel."""
    band = np.digitize(spectra.frequency_hz, _STRATA_HZ) - 1
    both = np.concatenate([band, band])
    return np.asarray((both[:, None] * senses + np.arange(senses)).reshape(-1))


def _external(fitted: CampaignFit) -> FloatArray:
    """d smooth coordinates / d parameters (P, P) at the fit."""
    model, values = fitted.model, fitted.values
    out = np.zeros((len(model.free), len(model.free)))
    for i, name in enumerate(model.free):
        size = max(abs(values[name]), model.by_name[name].scale) * 1e-6
        pair = [model.to_internal({**values, name: values[name] + sign * size}) for sign in (1.0, -1.0)]
        out[:, i] = (pair[0] - pair[1]) / (2.0 * size)
    return out


def labels_of(record: Record, campaign: Campaign) -> Mapping[str, str]:
    """Level, direction and drives of a record, in words that group records."""
    peaks = np.max(np.abs(record.drive_v), axis=0)
    most = max(float(np.max(np.abs(r.drive_v))) for r in campaign.records) or 1.0
    on = [d for d in range(peaks.size) if peaks[d] > 0.01 * most]
    direction = "none"
    if on:
        v = record.drive_v[:, on[0]]
        signs = np.signbit(v)
        half = v.size // 2
        early, late = np.count_nonzero(np.diff(signs[:half])), np.count_nonzero(np.diff(signs[half:]))
        direction = "up" if late > 1.1 * early else ("down" if early > 1.1 * late else "flat")
        if on[0] == 1 and direction in ("up", "down"):
            direction = "down" if direction == "up" else "up"
    return {
        "level": f"{float(peaks.max()) / most:.2g}",
        "direction": direction,
        "drives": "+".join(str(d + 1) for d in on) or "none",
    }
