"""A campaign as a ``Problem`` of criticism: fits, signatures of absent effects, probes and regions of the residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.announce import announce_fit
from ...criticism.problem import FitResult, LocalCandidate, Region, Signatures, Spectrum
from ...criticism.regions import pooled_spectra
from ...criticism.regression import STARTS
from ...criticism.verdict import STALE
from ...device.model import Model
from ...errors import GyroscreenError
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign
from ...inference.general.fit import CampaignFit, fit_with_columns
from ...inference.general.linear_step import relative_change
from ...inference.general.residuals import CampaignResiduals
from ...inference.general.scales import scaled_to, top_hz
from ...inference.general.variation import RecordVariation
from ...inference.screening.dependent_noise import DependentNoise
from ..where.partition import (
    CampaignPartition,
    RecordPartition,
    campaign_partition,
    record_partitions,
    residual_spectra,
)
from ..where.regions import misfit_regions, structure_regions
from .curved import corrected_beside, curved_terms, spread_starts, trigger_offset
from .mode_grid import Scan, mode_scans
from .modes import mode_candidate
from .probes import probe_signatures
from .rows import FourierRows, fit_result, spectra_of, strata_of
from .signatures import KnownSignatures, disturbance_candidate, known_signatures


class CampaignProblem:
    """The ``Problem`` of one campaign.  Fits and signatures are kept, because they are requested again.

    Parameters
    ----------
    campaign : with at least one record of role "fit".
    model : the model to start from.
    noise : level of each channel, (S,) [V].
    threads : signatures that are computed, and records that are integrated, in parallel.
    corrected : where the records differ: the measured campaign and the variation for which ``campaign`` was corrected.
    dependent : noise that depends on the signal and is contained in ``noise``, if any.
    curved_starts : full name -> start value of parameters of curved terms, beside which the records were corrected.
    """

    def __init__(
        self,
        campaign: Campaign,
        model: Model,
        noise: NoiseLevel,
        threads: int = 1,
        corrected: tuple[Campaign, RecordVariation] | None = None,
        dependent: DependentNoise | None = None,
        curved_starts: Mapping[str, float] | None = None,
    ) -> None:
        self.dependent = dependent
        self.curved_starts = dict(curved_starts or {})
        self.campaign = campaign
        self.measured = campaign if corrected is None else corrected[0]
        self.variation = None if corrected is None else corrected[1]
        self.threads = threads
        self.noise = noise
        self.records = campaign.with_role("fit")
        first = self.records[0]
        self.model = scaled_to(model.with_channels(first.sense_v.shape[1], first.drive_v.shape[1]), campaign)
        self._fits: dict[frozenset[str], tuple[CampaignFit, FitResult]] = {}
        self._known: KnownSignatures | None = None
        self._probes: tuple[CampaignFit, Signatures] | None = None
        self._offset: tuple[FloatArray, ...] = ()
        # Effects that add a mode, with the full names of its frequency and damping ratio.
        self._modes = {name: effect.mode for name, effect in self.model.library.items() if effect.mode is not None}
        self._mode_starts: dict[tuple[str, frozenset[str]], tuple[float, ...]] = {}

    @cached_property
    def top_hz(self) -> float:
        """Upper end of the rows [Hz]."""
        return top_hz(self.records)

    @cached_property
    def spectra(self) -> tuple[FourierRows, ...]:
        """For each fit record its transform (N, S) -> (2 F, S)."""
        return tuple(spectra_of(record, self.top_hz) for record in self.records)

    @cached_property
    def strata(self) -> tuple[IntArray, ...]:
        """For each fit record (2 F S,) the noise stratum of every row."""
        return tuple(strata_of(s, record.sense_v.shape[1]) for record, s in zip(self.records, self.spectra))

    @cached_property
    def partitions(self) -> dict[str, RecordPartition]:
        """The partition of each record by name, from the first fit; it is the same for all models."""
        return record_partitions(self.campaign, self.campaign_fit(tuple(next(iter(self._fits)))))

    @cached_property
    def partition(self) -> CampaignPartition:
        """The partition of the campaign, from the fit of the first model; it is the same for all models."""
        self.fit(())
        return campaign_partition(self.campaign_fit(()), self.partitions)

    @cached_property
    def scans(self) -> tuple[Scan, ...]:
        """The scan for an additional mode, one per drive group."""
        bins = [spectra.bins.size for spectra in self.spectra]
        low_hz = self.model.built.shape.scale.modes_hz[0]
        return mode_scans(self.campaign, bins, low_hz, self.top_hz, self.model.plant.sense, self.noise)

    def campaign_fit(self, terms: Sequence[str]) -> CampaignFit:
        """The fit with these terms, which ``fit`` made before."""
        return self._fits[frozenset(terms)][0]

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """Least squares with these terms in the model, from the parameters of ``start`` if given.

        Where the fit raises a GyroscreenError or LinAlgError, ``ok`` is false and ``why`` is its message.
        """
        key = frozenset(terms)
        if key not in self._fits:
            announce_fit(terms)
            model = self.model
            for term in terms:
                model = model.with_effect(term)
            known = None if start is None else {name: value for name, (value, _) in start.parameters.items()}
            spread = spread_starts(self.model, terms, self.curved, self.variation)
            values = None if known is None else {**spread, **self.curved_starts, **known}
            likely = {mode[0]: self._mode_starts.get((name, key - {name}), ()) for name, mode in self._modes.items()}
            try:
                fitted, columns = fit_with_columns(model, self.campaign, self.noise, values, likely, self.threads)
                # A curved term that starts beside its null may end in a minimum above the fit without it.
                if start is not None and fitted.chi2 > start.chi2 and values != known:
                    fitted, columns = fit_with_columns(model, self.campaign, self.noise, known, likely, self.threads)
                free = self._trigger_offset(fitted)
                result = fit_result(fitted, columns, terms, self.campaign, self.spectra, self.strata, free)
            except (GyroscreenError, np.linalg.LinAlgError) as error:
                return FitResult(False, terms, {}, (), (), why=str(error))
            self._fits[key] = fitted, result
        return self._fits[key][1]

    def signatures(self, fit: FitResult) -> Signatures:
        """Z (2 F S, K) of all absent effects; reused until the predictions have moved by the share ``STALE``."""
        fitted = self.campaign_fit(fit.terms)
        library, absent = fitted.model.library, fitted.model.candidates()
        names = [name for name in absent if name not in self._modes and library[name].disturbance is None]
        with ThreadPoolExecutor(self.threads) as pool:
            scanned = [pool.submit(self._mode, name, fit) for name in absent if name in self._modes]
            disturbances = [
                pool.submit(disturbance_candidate, fitted, self.records, name)
                for name in absent
                if library[name].disturbance
            ]
            known = self._known
            if known is None or known.moved(fitted) > STALE or not set(names) <= known.requested:
                residuals = self._residuals(fitted)
                known = known_signatures(residuals, fitted, names, self.records, self.spectra, self.strata, pool)
                self._known = known
        candidates = tuple(c for c in known.candidates if c.name in names)
        found = [job.result() for job in disturbances]
        local = [*(one for one in found if one is not None), *(mode for job in scanned for mode in job.result())]
        beside = corrected_beside(self.model, self.curved, self.curved_starts)
        return Signatures(candidates, known.blocks, tuple(local), known.grams, self.curved, beside)

    def _mode(self, name: str, fit: FitResult) -> tuple[LocalCandidate, ...]:
        """The mode of an effect as a candidate, if its grid is not empty; its best frequencies are kept as starts of a fit."""
        if not any(scan.points for scan in self.scans):
            return ()
        mode, senses = self._modes[name], self.model.built.shape.senses
        found = mode_candidate(name, mode, fit, self.scans, senses, self.noise.sigma_v)
        order = np.argsort(found.delta_chi2s)[::-1][:STARTS]
        self._mode_starts[name, frozenset(fit.terms)] = tuple(found.grid[i][mode[0]] for i in order)
        return (found,)

    def probes(self, fit: FitResult) -> Signatures:
        """Generic shapes (2 F S, K) that almost any missing effect resembles; reused as the signatures are."""
        fitted = self.campaign_fit(fit.terms)
        if self._probes is None or _moved(self._probes[0], fitted) > STALE:
            self._probes = fitted, probe_signatures(self._residuals(fitted), fitted, self.records, self.spectra)
        return self._probes[1]

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """Residual energy of each record and channel by resonance, harmonic, band and time, up to Nyquist."""
        return structure_regions(self.campaign_fit(fit.terms), self.partitions)

    def misfit_regions(self, terms: Sequence[str]) -> list[Region]:
        """The residual of the model with these terms by every family of the answer."""
        conditions = {block.name: block.labels for block in self.fit(()).blocks}
        return misfit_regions(self.campaign_fit(terms), self.partition, conditions)

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """Residual energy of all records by frequency, up to Nyquist."""
        return pooled_spectra(residual_spectra(self.campaign_fit(fit.terms), self.partitions))

    def _trigger_offset(self, fitted: CampaignFit) -> Sequence[FloatArray]:
        """As of ``curved.trigger_offset``, at the first fit that asks."""
        if not self._offset:
            self._offset = trigger_offset(self._residuals(fitted), fitted, self.records, self.variation)
        return self._offset

    @cached_property
    def curved(self) -> frozenset[str]:
        """As of ``curved.curved_terms``."""
        return curved_terms(self.model, self.variation)

    def fitted_names(self, fit: FitResult) -> tuple[str, ...]:
        """The free parameters of the model."""
        return self.campaign_fit(fit.terms).model.free

    def with_records(
        self,
        campaign: Campaign,
        noise: NoiseLevel,
        corrected: tuple[Campaign, RecordVariation] | None = None,
        dependent: DependentNoise | None = None,
        curved_starts: Mapping[str, float] | None = None,
    ) -> CampaignProblem:
        """The problem with other records; arguments as of the class."""
        return CampaignProblem(campaign, self.model, noise, self.threads, corrected, dependent, curved_starts)

    def _residuals(self, fitted: CampaignFit) -> CampaignResiduals:
        return CampaignResiduals(fitted.model, self.campaign, self.noise, self.threads)


def _moved(before: CampaignFit, now: CampaignFit) -> float:
    """rms(change) / rms(prediction) of the predicted fit records from one fit to another [1]."""
    old, new = ([record.predicted_v for record in fit.of_role("fit")] for fit in (before, now))
    return relative_change(old, new)
