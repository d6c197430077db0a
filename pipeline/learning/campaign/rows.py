"""A fitted campaign as a ``FitResult`` of criticism: whitened Fourier coefficients of its residuals and Jacobian.

A record becomes, channel by channel, the coefficients sqrt(2/N) (Re, Im) Y(w)/sigma of its bins above zero up to the top
of the rows (``inference.general.scales.top_hz``).
This is a unitary transform of that part of the data; the bin at zero is the free offset.

Shapes: N samples, S senses, F bins, P free parameters; a block of residuals is (2 F, S), its rows in C order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft

from ...arrays import FloatArray, IntArray
from ...criticism.problem import FitResult, ResidualBlock
from ...device.model import Model
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit
from ...inference.general.goodness import structured_misfit
from ...inference.general.linear_step import Sensitivity
from ...inference.general.record_fit import RecordFit
from ...inference.general.residuals import CampaignResiduals, Task
from ...inference.general.resonances import resonances_of

#: Two modes overlap if their frequencies differ by less than this many half-widths.
APART = 3.0
#: Usable share of the anti-alias corner, of Nyquist and of full scale.
USABLE = 0.9
#: Lines that are transformed together: one in each lane of a vector of the processor.
_TOGETHER = 8


@dataclass(frozen=True, eq=False)
class FourierRows:
    """The transform of one record of ``samples`` samples to rows: its ``bins`` (F,), their frequencies (F,) and end [Hz]."""

    samples: int
    bins: IntArray
    frequency_hz: FloatArray
    top_hz: float

    def __call__(self, y: FloatArray, sigma: FloatArray | None = None) -> FloatArray:
        """(.., N, S) -> (.., 2 F, S): unitary real Fourier coefficients; those of y / sigma where ``sigma`` (S,) is given."""
        senses = y.shape[-1]
        lines = y.reshape(-1, *y.shape[-2:])
        out = np.zeros((lines.shape[0], 2 * self.bins.size, senses))
        first, last = int(self.bins[0]), int(self.bins[-1]) + 1
        acting = [(i, s) for i, s in np.ndindex(lines.shape[0], senses) if lines[i, :, s].any()]
        # Along the last, contiguous axis a transform is several times faster than down a column.
        work = np.empty((min(_TOGETHER, len(acting)), self.samples))
        for begin in range(0, len(acting), _TOGETHER):
            some = acting[begin : begin + _TOGETHER]
            for line, (i, s) in zip(work, some):
                np.divide(lines[i, :, s], 1.0 if sigma is None else sigma[s], out=line)
            found = rfft(work[: len(some)])[:, first:last]
            found *= np.sqrt(2.0 / self.samples)
            for (i, s), c in zip(some, found):
                out[i, : self.bins.size, s], out[i, self.bins.size :, s] = c.real, c.imag
        return out.reshape(*y.shape[:-2], *out.shape[1:])

    def columns(self, jacobian: FloatArray, senses: int) -> FloatArray:
        """(N S, k) -> (2 F S, k): the rows of each column, sqrt(2/N) (Re, Im) of its Fourier coefficients."""
        k = jacobian.shape[1]
        return self(jacobian.T.reshape(k, self.samples, senses)).reshape(k, -1).T


def spectra_of(record: Record, top_hz: float) -> FourierRows:
    """Bins above zero, up to ``top_hz`` [Hz] and below Nyquist."""
    n, rate = record.drive_v.shape[0], record.sample_rate_hz
    bins = np.arange(1, (n - 1) // 2 + 1)
    frequency = bins * rate / n
    kept = frequency <= top_hz
    return FourierRows(n, bins[kept], frequency[kept], top_hz)


def white_rows(problem: CampaignResiduals, task: Task, spectrum: FourierRows, y: FloatArray) -> FloatArray:
    """Rows (k, 2 F S) [sigma] of changes y (k, N, S) [V] of the record of ``task``."""
    # A free offset is the bin at zero, which is not among the rows.
    plain = task.basis.shape[1] == 1 and task.masked is None and task.whitening.is_white
    white = spectrum(y, problem.sigma_v) if plain else spectrum(problem.whiten(y, task))
    return white.reshape(y.shape[0], -1)


def strata_of(spectra: FourierRows, senses: int) -> IntArray:
    """(2 F S,) noise stratum of each row: channel, and octave below the top of the rows (the first is all below a quarter)."""
    band = np.digitize(spectra.frequency_hz, (spectra.top_hz / 4.0, spectra.top_hz / 2.0))
    both = np.concatenate([band, band])
    return np.asarray((both[:, None] * senses + np.arange(senses)).reshape(-1))


def fit_result(
    fitted: CampaignFit,
    sensitivities: Sequence[Sensitivity],
    terms: tuple[str, ...],
    campaign: Campaign,
    spectra: Sequence[FourierRows],
    strata: tuple[IntArray, ...],
    free: Sequence[FloatArray] = (),
) -> FitResult:
    """The fit of a campaign with some effects, as criticism takes it.

    Parameters
    ----------
    fitted, sensitivities : the fit, and for each fit record its columns (N S, P) and those of its initial state, in sigmas.
    terms : effects in the model beside the given ones.
    campaign : its records.
    spectra, strata : of each fit record: its transform, and (2 F S,) the noise stratum of each row.
    free : for each fit record columns (N S, k), in sigmas, of signals whose size nothing determines; tests project them out.
    """
    names, noise_known = fitted.model.free, fitted.noise.known
    columns = {
        term: tuple(i for i, name in enumerate(names) if name in fitted.model.parameters_of(term)) for term in terms
    }
    derived = {}
    if fitted.theta_deg is not None and fitted.split_hz is not None:
        derived = {"theta_deg": fitted.theta_deg, "split_hz": fitted.split_hz}
    top_hz = spectra[0].top_hz
    blocks = tuple(_block(record, fitted, campaign, top_hz) for record in campaign.with_role("fit"))
    jacobians = _jacobians(fitted, sensitivities, spectra, free)
    ok = fitted.converged and bool(np.isfinite(fitted.chi2))
    why = "" if ok else f"it stopped before it converged, at {100 * (fitted.relative_error['fit'] or 0):.3g} % error"
    if ok and not all(bool(np.isfinite(block).all()) for block in jacobians):
        ok, why = False, "a change of the parameters found gives no device"
    return FitResult(
        ok,
        terms,
        fitted.parameters,
        blocks,
        jacobians,
        derived=derived,
        held=tuple(_block(record, fitted, campaign, top_hz) for record in campaign.with_role("validate")),
        columns=columns,
        shifts={term: tuple(_shift(fitted, names[i]) for i in columns[term]) for term in terms},
        strata=strata,
        noise_known=noise_known,
        nuisances=sum(block.nuisances for block in blocks),
        error={k: v for k, v in fitted.error.items() if v is not None and noise_known},
        relative_error={k: v for k, v in fitted.relative_error.items() if v is not None},
        why=why,
        noise_bounded=not noise_known,
        error_given=fitted.noise.independent,
        misfit=structured_misfit(fitted, campaign) or "",
        at_limit=tuple(
            term
            for term in terms
            if any(_at_limit(fitted, names[i]) for i in columns[term]) or _overlaps_resonance(fitted, term)
        ),
    )


def _jacobians(
    fitted: CampaignFit,
    sensitivities: Sequence[Sensitivity],
    spectra: Sequence[FourierRows],
    free: Sequence[FloatArray],
) -> tuple[FloatArray, ...]:
    """For each fit record (2 F S, P + all initial states + k): columns of the parameters, the initial states, and ``free``."""
    to_coordinates, senses = coordinate_jacobian(fitted.model, fitted.values), fitted.records[0].residual.shape[1]
    jacobians, starts = [], []
    for transform, (j, f) in zip(spectra, sensitivities):
        jacobians.append(transform.columns(j, senses) @ to_coordinates)
        starts.append(np.zeros((jacobians[-1].shape[0], 0)) if f is None else transform.columns(f, senses))
    if any(f.shape[1] for f in starts):
        jacobians = [np.concatenate(parts, axis=1) for parts in zip(jacobians, _block_diagonal(starts))]
    if free:
        wide = [transform.columns(one, senses) for transform, one in zip(spectra, free)]
        jacobians = [np.concatenate(parts, axis=1) for parts in zip(jacobians, wide)]
    return tuple(jacobians)


def coordinate_jacobian(model: Model, values: Mapping[str, float]) -> FloatArray:
    """d smooth coordinates / d free parameters (P, P) at complete ``values``."""
    out = np.zeros((len(model.free), len(model.free)))
    for i, name in enumerate(model.free):
        size = max(abs(values[name]), model.by_name[name].scale) * 1e-6
        pair = [model.to_internal({**values, name: values[name] + sign * size}) for sign in (1.0, -1.0)]
        out[:, i] = (pair[0] - pair[1]) / (2.0 * size)
    return out


def _block_diagonal(parts: Sequence[FloatArray]) -> list[FloatArray]:
    """Columns of single records (n_b, k_b) as columns of all of them (n_b, sum k)."""
    edges = np.cumsum([0, *(part.shape[1] for part in parts)])
    out = []
    for part, first in zip(parts, edges):
        wide = np.zeros((part.shape[0], int(edges[-1])))
        wide[:, first : first + part.shape[1]] = part
        out.append(wide)
    return out


def _block(record: Record, fitted: CampaignFit, campaign: Campaign, top_hz: float) -> ResidualBlock:
    mine = next(r for r in fitted.records if r.name == record.name)
    return block_of(record, campaign, spectra_of(record, top_hz)(mine.residual), _free_amplitudes(mine))


def block_of(record: Record, campaign: Campaign, rows: FloatArray, nuisances: int) -> ResidualBlock:
    """The block of a record with its conditions; ``rows`` (2 F, S) and the number of free amplitudes."""
    repeats = [r.name for r in campaign.records if r.role == record.role and _same_drive(r, record)]
    labels = _labels(record, campaign)
    return ResidualBlock(record.name, rows, labels, repeats[0] if len(repeats) > 1 else None, nuisances)


def _free_amplitudes(mine: RecordFit) -> int:
    """Free amplitudes of a record other than its offsets (the bins at zero) and its initial state (columns of J)."""
    samples, senses = mine.residual.shape
    start = 0 if mine.start is None else mine.start.size
    return samples * senses - mine.dof - senses - start


def _same_drive(a: Record, b: Record) -> bool:
    """Whether two records have the same drive; without one each begins in its own state, so they are no repeats."""
    return bool(np.any(a.drive_v)) and a.drive_v.shape == b.drive_v.shape and bool(np.array_equal(a.drive_v, b.drive_v))


def _labels(record: Record, campaign: Campaign) -> Mapping[str, str]:
    """Level (relative to the highest of the campaign), sweep direction and active drives of a record."""
    peaks = np.max(np.abs(record.drive_v), axis=0)
    most = max(float(np.max(np.abs(r.drive_v), initial=0.0)) for r in campaign.records) or 1.0
    on = [d for d in range(peaks.size) if peaks[d] > 0.01 * most]
    if not on:
        # Without a drive the motion is the level: each piece of a decay has its own.
        rms = float(np.sqrt(np.mean(np.var(record.sense_v, axis=0))))
        strongest = max(float(np.sqrt(np.mean(np.var(r.sense_v, axis=0)))) for r in campaign.records)
        return {"level": f"{rms / max(strongest, 1e-300):.2g}", "direction": "none", "drives": "none"}
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
        "drives": "+".join(str(d + 1) for d in on),
    }


def _shift(fitted: CampaignFit, name: str) -> float:
    """Distance of a parameter from its null; 0 if the parameter does not exist at the null."""
    parameter = fitted.model.by_name[name]
    return 0.0 if parameter.grid else fitted.values[name] - parameter.null


def _at_limit(fitted: CampaignFit, name: str) -> bool:
    """Whether a parameter lies at an end of its range that is not its null."""
    low, high = fitted.model.bounds(name)
    value, null = fitted.values[name], fitted.model.by_name[name].null
    return value in (low, high) and value != null


def _overlaps_resonance(fitted: CampaignFit, term: str) -> bool:
    """Whether a term adds a mode in the resonance of another mode: it then only corrects that mode's residue."""
    model, values = fitted.model, fitted.values
    mode = model.effect(term).mode
    if mode is None:
        return False
    f, zeta = (values[name] for name in mode)
    added = [effect.mode for effect in model.ordered_effects() if effect.mode not in (None, mode)]
    others = [(values[other[0]], values[other[1]] * values[other[0]]) for other in added if other is not None]
    return any(abs(f - g) < APART * (zeta * f + width) for g, width in (*resonances_of(values), *others))
