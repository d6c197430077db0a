"""Where a model fails on a campaign: the residual cut by frequency, time, channel, level, direction and record.

By frequency, in the full band up to Nyquist, every part of the whole is in one region (the cells of an orthonormal
transform), so the shares of resonance, harmonic, line and broadband add up to one together.  The other families (time; level of
the drive; response, the level of the motion; direction of the sweep; channel; record) cut the same residual along one line each
and add up to one by themselves, never across.

Shapes: N samples, S senses, K blocks, M bins; residuals in sigmas.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.problem import Region, Spectrum
from ...experiment.noise.time_frequency import lapped
from ...inference.general.fit import CampaignFit, RecordFit
from .lines import lines_in, merged, pooled, spectrum_of, without_these
from .plane import LEVELS, Place, Plane, short_blocks

#: Kinds that cut by frequency: their shares add up to one together.
FREQUENCY_KINDS = ("resonance", "harmonic", "line", "broadband")
#: Families that add up to one by themselves, in the order in which they are told.
FAMILIES = ("frequency", "time", "level", "response", "direction", "channel", "record")
_WINDOWS = 12
#: Samples are clipped here for tests that heavy-tailed noise must not set off.
_CLIP = 4.0


@dataclass(frozen=True, eq=False)
class Layout:
    """The cut of a campaign: the plane of each record by name, and the lines [Hz]; the same for all models tried on it."""

    planes: Mapping[str, Plane]
    lines_hz: tuple[float, ...]


def layout_of(fit: CampaignFit, planes: Mapping[str, Plane]) -> Layout:
    """``planes`` and the lines that the residual of ``fit`` shows in its fitted records, in one of them or in all together."""
    fitted = fit.of_role("fit")
    spectra = residual_spectra(fit, planes)
    found: list[float] = []
    for mine, spectrum in zip(fitted, spectra):
        found += lines_in(spectrum, planes[mine.name].answers_hz)
    answers = [band for mine in fitted for band in planes[mine.name].answers_hz]
    for spectrum in pooled(spectra):
        found += lines_in(spectrum, answers)
    widths = (planes[mine.name].sample_rate_hz / mine.residual.shape[0] for mine in fitted)
    return Layout(planes, tuple(merged(found, 1.5 * max(widths, default=0.0))))


def residual_spectra(fit: CampaignFit, planes: Mapping[str, Plane]) -> list[Spectrum]:
    """The residual of each fitted record by frequency."""
    return [spectrum_of(mine.residual, planes[mine.name].sample_rate_hz) for mine in fit.of_role("fit")]


def regions_of(fit: CampaignFit, planes: Mapping[str, Plane]) -> list[Region]:
    """Regions for tests of structure: by time, fine band, resonance and harmonic of each fitted record and channel.

    All are small beside the silence from which the noise level was learned, so that its error does no harm.
    """
    out: list[Region] = []
    for mine in fit.of_role("fit"):
        plane, scale = planes[mine.name], _scale(fit, mine)
        bounded = np.clip(mine.residual, -_CLIP, _CLIP)
        whole, robust = (lapped(y, plane.size) ** 2 for y in (mine.residual, bounded))
        for channel in range(mine.residual.shape[1]):
            base = {"record": mine.name, "channel": f"sense{channel + 1}"}
            parts, least = (_summed(plane.cell, c[channel], len(plane.places)) for c in (whole, robust))
            out += [
                Region(place.kind, {**base, **_labels(place)}, chi2, dof * scale, less)
                for place, chi2, dof, less in zip(plane.places, parts, plane.place_dof.tolist(), least)
                if dof > 0.0 and place.kind in ("resonance", "harmonic")
            ]
            parts, least = (_summed(plane.band, c[channel].sum(axis=0), len(plane.bands)) for c in (whole, robust))
            out += [
                Region("band", {**base, "band_hz": list(band)}, chi2, dof * scale, less)
                for band, chi2, dof, less in zip(plane.bands, parts, plane.band_dof.tolist(), least)
            ]
            for span, rows in _windows(mine, plane):
                chi2, less = (float(np.sum(y[rows, channel] ** 2)) for y in (mine.residual, bounded))
                out.append(Region("time", {**base, "time_s": span}, chi2, (rows.stop - rows.start) * scale, less))
    return out


def decomposed(fit: CampaignFit, layout: Layout, conditions: Mapping[str, Mapping[str, str]]) -> list[Region]:
    """The residual of the fitted records cut by every one of ``FAMILIES``.

    Parameters
    ----------
    fit, layout : the model, and the cut.
    conditions : "level" and "direction" of each record by name.
    """
    out: list[Region] = []
    pooled: dict[tuple[str, str], tuple[dict[str, object], list[float]]] = {}
    for mine in fit.of_role("fit"):
        plane, scale = layout.planes[mine.name], _scale(fit, mine)
        left, taken = without_these(mine.residual, plane.sample_rate_hz, layout.lines_hz)
        cells = lapped(left, plane.size) ** 2
        # Two degrees of freedom a line and channel are missing, spread thinly over the plane.
        thin = scale * (1.0 - 2.0 * len(layout.lines_hz) / left.shape[0])
        level = np.mean(short_blocks(mine.residual) ** 2, axis=1)
        length = mine.residual.shape[0] // level.shape[0]
        for channel in range(left.shape[1]):
            sense = f"sense{channel + 1}"
            base: dict[str, object] = {"record": mine.name, "channel": sense}
            half = 0.5 * plane.sample_rate_hz / left.shape[0]
            for f, energy in zip(layout.lines_hz, taken[:, channel].tolist()):
                band = [float(f - half), float(f + half)]
                out.append(Region("frequency", {**base, "kind": "line", "band_hz": band}, energy, 2.0 * scale))
            parts = _summed(plane.cell, cells[channel], len(plane.places))
            out += [
                Region("frequency", {**base, "kind": place.kind, **_labels(place)}, chi2, dof * thin)
                for place, chi2, dof in zip(plane.places, parts, plane.place_dof.tolist())
                if dof > 0.0
            ]
            for span, rows in _windows(mine, plane):
                chi2 = float(np.sum(mine.residual[rows, channel] ** 2))
                out.append(Region("time", {**base, "time_s": span}, chi2, (rows.stop - rows.start) * scale))
            chi2, dof = float(np.sum(mine.residual[:, channel] ** 2)), left.shape[0] * scale
            for family, label in (
                ("level", float(conditions[mine.name]["level"])),
                ("direction", conditions[mine.name]["direction"]),
                ("channel", sense),
                ("record", mine.name),
            ):
                _add(pooled, family, {family: label}, chi2, dof)
            parts = _summed(plane.level[:, channel], level[:, channel] * length, LEVELS)
            sizes = np.bincount(plane.level[:, channel], minlength=LEVELS) * length * scale
            for k in np.flatnonzero(sizes).tolist():
                span = [float(v) for v in plane.level_v[k : k + 2, channel]]
                _add(pooled, "response", {"channel": sense, "response_v": span}, parts[k], float(sizes[k]))
    out += [Region(family, label, *sums) for (family, _), (label, sums) in pooled.items()]
    return out


def _add(
    pooled: dict[tuple[str, str], tuple[dict[str, object], list[float]]],
    family: str,
    label: dict[str, object],
    chi2: float,
    dof: float,
) -> None:
    _, sums = pooled.setdefault((family, repr(label)), (label, [0.0, 0.0]))
    sums[0] += chi2
    sums[1] += dof


def _scale(fit: CampaignFit, mine: RecordFit) -> float:
    """Degrees of freedom a sample, less those that nuisances and parameters took."""
    parameters = len(fit.model.free)
    return mine.dof / mine.residual.size * (1.0 - parameters / max(fit.dof + parameters, 1))


def _summed(index: IntArray, energy: FloatArray, count: int) -> list[float]:
    sums: list[float] = np.bincount(index.reshape(-1), energy.reshape(-1), count).tolist()
    return sums


def _windows(mine: RecordFit, plane: Plane) -> Iterator[tuple[list[float], slice]]:
    """Equal windows: [from, to] in seconds, and the samples."""
    edges = np.linspace(0, mine.residual.shape[0], _WINDOWS + 1).round().astype(int).tolist()
    for first, stop in pairwise(edges):
        yield [first / plane.sample_rate_hz, stop / plane.sample_rate_hz], slice(first, stop)


def _labels(place: Place) -> dict[str, object]:
    labels: dict[str, object] = {"harmonic": place.order} if place.order else {}
    return {"band_hz": list(place.band_hz), **labels}
