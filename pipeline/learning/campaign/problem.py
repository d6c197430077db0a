"""A campaign as criticism sees it: blocks of whitened Fourier coefficients, jacobian, signatures, probes, regions.

A record of N samples becomes, channel by channel, the coefficients sqrt(2/N) (Re, Im) Y(w)/sigma of the bins above zero up to
``TOP_HZ`` (a unitary picture of that part of the data; the bin at zero is the free offset).  Lines and transients that are
free in a record are projected out before.

Shapes: N samples, S senses, F bins; rows of a block 2 F, columns S.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.lines import pooled_spectra
from ...criticism.problem import (
    Candidate,
    FitResult,
    LocalCandidate,
    Region,
    ResidualBlock,
    Signatures,
    Spectrum,
    TermParameter,
)
from ...criticism.projection import stratum_grams
from ...device.model import Model
from ...errors import GyroscreenError
from ...experiment.forward.drive_groups import drive_groups_of
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit, RecordFit, fit_with_columns
from ...inference.general.free_disturbances import free_shapes
from ...inference.general.gauss_newton import Sensitivity, moved_share
from ...inference.general.residuals import CampaignResiduals
from ..where.partition import RecordPartition, record_partitions, residual_spectra, resonances_of
from ..where.regions import structure_regions
from .modes import NAME as MODE
from .modes import Scan, grid_of, mode_candidate, scan_of
from .rows import TOP_HZ, FourierRows, block_diagonal, labels_of, same_drive, spectra_of, strata_of
from .signatures import signature_of, tangent_of

#: Room for the columns of signatures, enlarged where users bring more effects.
_COLUMNS = 100
#: Half widths by which the frequencies of two modes differ at least.
_APART = 3.0
#: Frequencies of the scan for one more mode that a fit starts from.
_LIKELY = 3
#: Share of Nyquist up to which a mode is looked for.
_BELOW_NYQUIST = 0.95
#: Signatures are taken anew once the fitted records have moved by this share of themselves.
_STALE = 0.05


@dataclass(frozen=True, eq=False)
class _Taken:
    """Signatures of some effects and the records of the model at which they were taken."""

    candidates: tuple[Candidate, ...]
    asked: frozenset[str]
    blocks: tuple[FloatArray, ...]
    grams: FloatArray
    predicted: Mapping[str, FloatArray]

    def moved(self, fitted: CampaignFit) -> float:
        """How far the fitted records have moved since, as a share of themselves."""
        now = fitted.of_role("fit")
        return moved_share([self.predicted[record.name] for record in now], [record.predicted_v for record in now])


class CampaignProblem:
    """The ``Problem`` of one campaign; fits and signatures are kept, for they are asked for again.

    ``threads`` of signatures are taken, and of records integrated, at once.
    """

    def __init__(self, campaign: Campaign, model: Model, noise: NoiseLevel, threads: int = 1) -> None:
        self.campaign = campaign
        self.threads = threads
        self.noise = noise
        first = campaign.with_role("fit")[0]
        self.model = model.with_channels(first.sense_v.shape[1], first.drive_v.shape[1])
        self.records = campaign.with_role("fit")
        self._fits: dict[frozenset[str], tuple[CampaignFit, FitResult]] = {}
        self._taken: _Taken | None = None
        self._modes: dict[frozenset[str], tuple[float, ...]] = {}

    @cached_property
    def spectra(self) -> tuple[FourierRows, ...]:
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
            likely = {f"{MODE}.f": self._modes.get(key - {MODE}, ())}
            try:
                fitted, columns = fit_with_columns(model, self.campaign, self.noise, begun, likely, self.threads)
                self._fits[key] = (fitted, self._result(fitted, columns, terms))
            except (GyroscreenError, np.linalg.LinAlgError) as error:
                return FitResult(False, terms, {}, (), (), why=str(error))
        return self._fits[key][1]

    @cached_property
    def strata(self) -> tuple[IntArray, ...]:
        """Noise stratum of every row of each fit record."""
        return tuple(strata_of(s, record.sense_v.shape[1]) for record, s in zip(self.records, self.spectra))

    def _result(self, fitted: CampaignFit, columns_of: Sequence[Sensitivity], terms: tuple[str, ...]) -> FitResult:
        turn = _external(fitted)
        jacobians, free_starts = [], []
        for record, spectra, (j, f) in zip(self.records, self.spectra, columns_of):
            shape = record.sense_v.shape
            jacobians.append(spectra(j.T.reshape(-1, *shape)).reshape(j.shape[1], -1).T @ turn)
            if f is None:
                free_starts.append(np.zeros((jacobians[-1].shape[0], 0)))
            else:
                free_starts.append(spectra(f.T.reshape(-1, *shape)).reshape(f.shape[1], -1).T)
        if any(f.shape[1] for f in free_starts):
            jacobians = [np.concatenate(parts, axis=1) for parts in zip(jacobians, block_diagonal(free_starts))]
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
            fitted.converged and bool(np.isfinite(fitted.chi2)),
            terms,
            fitted.parameters,
            blocks,
            tuple(jacobians),
            derived=derived,
            held=held,
            columns=columns,
            shifts=shifts,
            strata=self.strata,
            noise_known=known,
            nuisances=sum(block.nuisances for block in blocks),
            error={k: v for k, v in fitted.error.items() if v is not None and known},
            relative_error={k: v for k, v in fitted.relative_error.items() if v is not None},
            noise_bounded=not known,
            at_limit=tuple(
                term
                for term in terms
                if any(_ended(fitted, free[i]) for i in columns[term]) or (term == MODE and _coincides(fitted))
            ),
        )

    @staticmethod
    def _spent(mine: RecordFit) -> int:
        """Free amplitudes of a record beside its offsets, which are the bins at zero, and its initial state."""
        samples, senses = mine.residual.shape
        start = 0 if mine.start is None else mine.start.size
        return samples * senses - mine.dof - senses - start

    def _block(self, record: Record, fitted: CampaignFit) -> ResidualBlock:
        mine = next(r for r in fitted.records if r.name == record.name)
        twins = [r.name for r in self.campaign.records if r.role == record.role and same_drive(r, record)]
        return ResidualBlock(
            record.name,
            spectra_of(record)(mine.residual),
            labels_of(record, self.campaign),
            repeat=twins[0] if len(twins) > 1 else None,
            nuisances=self._spent(mine),
        )

    def signatures(self, fit: FitResult) -> Signatures:
        """Signatures of all absent effects; those taken at an earlier fit serve until the model has moved."""
        fitted = self.campaign_fit(fit.terms)
        absent = fitted.model.candidates()
        names = [name for name in absent if name != MODE and fitted.model.library[name].disturbance is None]
        free = [name for name in absent if fitted.model.library[name].disturbance]
        taken = self._taken
        with ThreadPoolExecutor(self.threads) as pool:
            mode = pool.submit(self._mode, fit) if MODE in absent else None
            disturbances = [pool.submit(self._free, fitted, name) for name in free]
            if taken is None or taken.moved(fitted) > _STALE or not set(names) <= taken.asked:
                taken = self._taken = self._take(fitted, names, pool)
        candidates = tuple(c for c in taken.candidates if c.name in names)
        local = [*(job.result() for job in disturbances), *(() if mode is None else mode.result())]
        return Signatures(candidates, taken.blocks, tuple(local), taken.grams)

    def _mode(self, fit: FitResult) -> tuple[LocalCandidate, ...]:
        """One more mode as a candidate, where the records leave room for its grid; its best frequencies are kept."""
        if not any(scan.points for scan in self.scans):
            return ()
        found = mode_candidate(fit, self.scans, self.model.built.shape.senses, self.noise.sigma_v)
        order = np.argsort(found.delta_chi2s)[::-1][:_LIKELY]
        self._modes[frozenset(fit.terms)] = tuple(found.grid[i][f"{MODE}.f"] for i in order)
        return (found,)

    @cached_property
    def scans(self) -> tuple[Scan, ...]:
        """The grid of one more mode, for each play of the fit records."""
        groups = drive_groups_of(self.records, self.campaign.instrument, self.campaign.angular_gain)
        # Near Nyquist a mode cannot be told from its image, which anything else may look like.
        top_hz = _BELOW_NYQUIST * 0.5 * self.records[0].sample_rate_hz
        grid = grid_of([group for _, group in groups], min(TOP_HZ, top_hz))
        displacement = self.model.plant.sense == "displacement"
        return tuple(
            scan_of(places, group, self.campaign.instrument, self.spectra[places[0]].bins.size, grid, displacement)
            for places, group in groups
        )

    def _take(self, fitted: CampaignFit, names: Sequence[str], pool: ThreadPoolExecutor) -> _Taken:
        problem = CampaignResiduals(fitted.model, self.campaign, self.noise.sigma_v, self.threads)
        tasks = problem.tasks(self.records, fitted.values)

        def rows(place: int, y: FloatArray) -> FloatArray:
            # A free offset is the bin at zero, which is left out anyway.
            free = tasks.each[place].basis.shape[1] > 1
            white = problem.whiten(y, tasks.each[place]) if free else y / self.noise.sigma_v
            return self.spectra[place](white).reshape(y.shape[0], -1)

        tangent = tangent_of(fitted, tasks, self.campaign.instrument, self.records, rows)
        candidates: list[Candidate] = []
        sizes = [2 * s.bins.size * record.sense_v.shape[1] for s, record in zip(self.spectra, self.records)]
        # By rows of memory: a column of a block is one run of it.  What is not written to takes no memory.
        room = [np.empty((_COLUMNS, size)) for size in sizes]
        width = 0
        for found in pool.map(partial(signature_of, tangent), names):
            if found is None:
                continue
            candidate, columns = found
            cells = tuple(slice(c.start + width, c.stop + width) for c in candidate.cells)
            candidates.append(replace(candidate, cells=cells))
            more = sum(part.shape[0] for part in columns[0])
            if width + more > room[0].shape[0]:
                room = [np.concatenate([old, np.empty((more + _COLUMNS, old.shape[1]))]) for old in room]
            for block, own in zip(room, columns):
                np.concatenate(own, out=block[width : width + more])
            width += more
        blocks = tuple(block[:width].T for block in room)
        predicted = {r.name: r.predicted_v for r in fitted.of_role("fit")}
        grams = stratum_grams(blocks, self.strata)
        return _Taken(tuple(candidates), frozenset(names), blocks, grams, predicted)

    def _free(self, fitted: CampaignFit, name: str) -> LocalCandidate:
        """Fall of chi2 that a disturbance with free amplitudes brings."""
        residuals = {r.name: r.residual for r in fitted.records}
        shapes = free_shapes(
            fitted.model.library[name],
            fitted.model.built.shape,
            [residuals[record.name] for record in self.records],
            [record.sample_rate_hz for record in self.records],
        )
        return LocalCandidate(
            name,
            tuple(shape.fall for shape in shapes),
            tuple(shape.dof for shape in shapes),
            tuple({f"{name}.{k}": v for k, v in shape.point.items()} for shape in shapes),
            levels=tuple(shape.level for shape in shapes),
        )

    def probes(self, fit: FitResult) -> Signatures:
        """Shapes that almost any missing physics touches: powers, drifts and cross-talk of the model's own response."""
        fitted = self.campaign_fit(fit.terms)
        problem = CampaignResiduals(fitted.model, self.campaign, self.noise.sigma_v)
        blocks = []
        count = 0
        for record, spectra in zip(self.records, self.spectra):
            y = next(r for r in fitted.records if r.name == record.name).predicted_v
            t = np.arange(y.shape[0])[:, None] / record.sample_rate_hz
            slope = np.gradient(y, axis=0)
            shapes = [y * t, y**2, y**3, np.abs(y) * y, y**2 * slope, slope, slope * t, y[:, ::-1], np.sign(y)]
            rows = spectra(problem.whiten(np.stack(shapes), problem.task(record, fitted.values)))
            # Each shape in each channel by itself.
            alone = rows[:, None] * np.eye(y.shape[1])[:, None, :]
            blocks.append(alone.reshape(len(shapes) * y.shape[1], -1).T)
            count = blocks[-1].shape[1]
        unit = (TermParameter("amplitude"),)
        candidates = tuple(Candidate(f"shape {i}", unit, (slice(i, i + 1),)) for i in range(count))
        return Signatures(candidates, tuple(blocks))

    @cached_property
    def partitions(self) -> dict[str, RecordPartition]:
        """The partition of each record by name, from the first fit; it is the same for all models."""
        return record_partitions(self.campaign, self.campaign_fit(tuple(next(iter(self._fits)))))

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """Residual energy of each record and channel by time, resonance, harmonic of the drive and band, up to Nyquist."""
        return structure_regions(self.campaign_fit(fit.terms), self.partitions)

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """Residual energy of all records by frequency, up to Nyquist."""
        return pooled_spectra(residual_spectra(self.campaign_fit(fit.terms), self.partitions))


def _ended(fitted: CampaignFit, name: str) -> bool:
    """Whether a parameter lies at an end of its range that is not its null."""
    low, high = fitted.model.bounds(name)
    value, null = fitted.values[name], fitted.model.by_name[name].null
    return value in (low, high) and value != null


def _coincides(fitted: CampaignFit) -> bool:
    """Whether the additional mode lies in the resonance of another: then it mends that one's residue and is no mode."""
    f, zeta = (fitted.values[f"{MODE}.{name}"] for name in ("f", "zeta"))
    return any(abs(f - other) < _APART * (zeta * f + width) for other, width in resonances_of(fitted.values))


def _is_quantity(term: str, name: str) -> bool:
    return term == "offdiagonal_damping" and name == "c12_per_s"


def _external(fitted: CampaignFit) -> FloatArray:
    """d smooth coordinates / d parameters (P, P) at the fit."""
    model, values = fitted.model, fitted.values
    out = np.zeros((len(model.free), len(model.free)))
    for i, name in enumerate(model.free):
        size = max(abs(values[name]), model.by_name[name].scale) * 1e-6
        pair = [model.to_internal({**values, name: values[name] + sign * size}) for sign in (1.0, -1.0)]
        out[:, i] = (pair[0] - pair[1]) / (2.0 * size)
    return out
