"""Residual energy of a campaign by region: one function per family of regions, on the partition of ``partition``.

Two sets of regions are made from the same functions:

    structure_regions   small regions of each record and channel, for the tests of structure in the residual
    misfit_regions      the families of the answer; the energies of each family add up to the whole residual

The significant ones become ``Place`` objects of the answer.

Shapes: N samples, S senses, K blocks, M bins; residuals in sigmas.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from msgspec import convert, structs
from scipy.special import ndtri

from ...arrays import FloatArray, IntArray
from ...criticism.budget import ALPHA
from ...criticism.goodness import WINDOW
from ...criticism.problem import Region
from ...criticism.regions import RegionShare, explained_share, region_shares
from ...experiment.noise.level import NoiseLevel
from ...experiment.noise.time_frequency import lapped
from ...inference.general.fit import CampaignFit
from ...inference.general.record_fit import RecordFit
from ..answers import Place
from .partition import LEVELS, CampaignPartition, RecordPartition, short_blocks, without_lines

#: Kinds of regions of the family "frequency"; their shares add up to one together.
FREQUENCY_KINDS = ("resonance", "harmonic", "line", "broadband")
#: Families of the answer, in its order; shares add up to one within a family.
FAMILIES = ("frequency", "time", "level", "response", "direction", "channel", "record")
_WINDOWS = 12
#: Families of a few regions each: all of them are reported as soon as one is significant.
_WHOLE = ("level", "direction", "channel", "record")
#: Largest number of items of a list: places of a family, pairs and rivals of effects.
LISTED = 12
#: Limit of a sample [sigma] in the energies of tests that must be robust to outliers: ``WINDOW`` samples of noise exceed it with
#: the probability ``ALPHA``.
_CLIP = -float(ndtri(ALPHA / (2.0 * WINDOW)))

Labels = Mapping[str, object]


def structure_regions(fit: CampaignFit, partitions: Mapping[str, RecordPartition]) -> list[Region]:
    """Resonances, harmonics, fine bands and time windows of each fitted record and channel.

    They have far fewer degrees of freedom than the silent record, so the uncertainty of a white noise level does not matter.  A
    density is known less well in a narrow band.
    """
    out: list[Region] = []
    for mine in fit.of_role("fit"):
        partition, density = partitions[mine.name], _dof_per_sample(fit, mine)
        clipped = np.clip(mine.residual, -_CLIP, _CLIP)
        whole, robust = (_structure(mine, y, partition, density) for y in (mine.residual, clipped))
        out += [
            replace(region, robust=other.chi2, noise_sd=_density_sd(fit.noise, region))
            for region, other in zip(whole, robust)
        ]
    return out


def _density_sd(noise: NoiseLevel, region: Region) -> float:
    """Relative sd of the noise density at the middle of the band of a region; 0 for white noise and for wide bands."""
    band, channel = region.labels.get("band_hz"), region.labels.get("channel")
    if region.family != "band" or noise.spectrum is None or noise.spectrum.white or not isinstance(band, list):
        return 0.0
    at = noise.spectrum.relative_sd(np.array([0.5 * (band[0] + band[1])]))
    return float(at[0, int(str(channel).removeprefix("sense")) - 1])


def _structure(mine: RecordFit, residual: FloatArray, partition: RecordPartition, density: float) -> list[Region]:
    cells = lapped(residual, partition.size) ** 2
    out: list[Region] = []
    for channel in range(residual.shape[1]):
        base = _base(mine.name, channel)
        areas = _by_area(base, cells[channel], partition, density)
        out += [region for region in areas if region.family != "broadband"]
        out += _by_band(base, cells[channel], partition, density)
        out += _by_time(base, residual[:, channel], _good(mine, channel), partition, density)
    return out


def misfit_regions(
    fit: CampaignFit, partition: CampaignPartition, conditions: Mapping[str, Mapping[str, str]]
) -> list[Region]:
    """The residual of the fitted records, by every one of ``FAMILIES``.

    Parameters
    ----------
    fit : the model and its residuals.
    partition : of the campaign.
    conditions : "level" and "direction" of each record by name.
    """
    out: list[Region] = []
    for mine in fit.of_role("fit"):
        own, density = partition.records[mine.name], _dof_per_sample(fit, mine)
        left, lines = without_lines(mine.residual, own.sample_rate_hz, partition.lines_hz)
        cells, blocks = lapped(left, own.size) ** 2, short_blocks(mine.residual)
        mean_square = np.mean(blocks**2, axis=1)
        # The lines took two degrees of freedom each per channel; the loss is spread evenly over the plane.
        thinned = density * (1.0 - 2.0 * len(partition.lines_hz) / left.shape[0])
        for channel in range(left.shape[1]):
            residual, base = mine.residual[:, channel], _base(mine.name, channel)
            out += _by_line(base, lines[:, channel], partition.lines_hz, own.sample_rate_hz / left.shape[0], density)
            areas = _by_area(base, cells[channel], own, thinned)
            out += [replace(area, family="frequency", labels={**area.labels, "kind": area.family}) for area in areas]
            out += _by_time(base, residual, _good(mine, channel), own, density)
            out += _by_response(channel, mean_square[:, channel] * blocks.shape[1], blocks.shape[1], own, density)
            out += _by_label({**base, **conditions[mine.name]}, residual, density)
    return _pooled(out)


def by_kind(regions: Sequence[Region]) -> list[Region]:
    """The family "frequency" summed over records and channels: by kind, order of the harmonic, resonant band and line."""
    groups: dict[tuple[object, ...], list[Region]] = {}
    for region in regions:
        if region.family == "frequency":
            kind = region.labels["kind"]
            # Bands of harmonics and broadband areas differ between records with different drives.
            band = None if kind in ("harmonic", "broadband") else str(region.labels["band_hz"])
            groups.setdefault((kind, region.labels.get("harmonic"), band), []).append(region)
    return [
        Region("frequency", _joined(own), sum(r.chi2 for r in own), sum(r.dof for r in own)) for own in groups.values()
    ]


def explained(before: Sequence[Region], after: Sequence[Region]) -> float:
    """1 - excess after / excess before, at most 1; the excess of some regions is sum(chi2 - dof)."""
    return min(explained_share(*(sum(r.chi2 - r.dof for r in regions) for regions in (before, after))), 1.0)


def explained_by_kind(before: Sequence[Region], after: Sequence[Region], kinds: Sequence[str]) -> dict[str, float]:
    """``explained`` for each of ``kinds`` of the family "frequency", by kind."""
    out = {}
    for kind in FREQUENCY_KINDS:
        if kind in kinds:
            own = [[r for r in regions if r.labels.get("kind") == kind] for regions in (before, after)]
            out[kind] = explained(own[0], own[1])
    return out


def significant_places(regions: Sequence[Region], noise_dof: float, after: Sequence[Region] = ()) -> tuple[Place, ...]:
    """Significant regions of every family, the largest share first, families in the order of ``FAMILIES``.

    Parameters
    ----------
    regions : of every family.
    noise_dof : degrees of freedom of the noise level, for the uncertainty of its F-test.
    after : the same regions with another model; a place then has the error with it and the share that it explains.
    """
    old, new = ({(r.family, repr(r.labels)): r for r in part} for part in (regions, after))
    found = region_shares(regions, np.inf, noise_dof)
    places: list[Place] = []
    for family in FAMILIES:
        own = [item for item in found if item.family == family]
        significant = [item for item in own if item.p_value < ALPHA]
        if significant and family in _WHOLE:
            significant = own
        for item in significant[:LISTED]:
            key = family, repr(item.labels)
            places.append(_place(item, old[key], new.get(key)))
    return tuple(places)


def remaining_shares(places: Sequence[Place]) -> dict[str, float]:
    """The share of each family that is in none of its places; families without a place are left out."""
    present = {place.family for place in places}
    sums = {f: sum(place.share for place in places if place.family == f) for f in FAMILIES if f in present}
    return {family: max(1.0 - total, 0.0) for family, total in sums.items()}


def _place(item: RegionShare, before: Region, after: Region | None) -> Place:
    # Edges lie on bins of a spectrum, so digits beyond the sixth carry no information.
    rounded = {k: [float(f"{end:.6g}") for end in v] if isinstance(v, list) else v for k, v in item.labels.items()}
    known = {"kind": item.family, "record": None, "channel": None, "band_hz": None, "time_s": None, **rounded}
    place = convert({**known, "family": item.family, "share": item.share, "error": item.error}, Place)
    if after is None:
        return place
    return structs.replace(place, error_after=math.sqrt(after.chi2 / after.dof), explained=explained([before], [after]))


def _by_area(base: Labels, cells: FloatArray, partition: RecordPartition, density: float) -> list[Region]:
    """Areas of the time-frequency plane, their kind as family; ``cells`` (K, M) are energies of one channel."""
    energy = _summed(partition.area_of_cell, cells, len(partition.areas))
    out = []
    for area, chi2, dof in zip(partition.areas, energy, partition.area_dof.tolist()):
        if dof > 0.0:
            order = {"harmonic": area.order} if area.order else {}
            out.append(Region(area.kind, {**base, "band_hz": list(area.band_hz), **order}, chi2, dof * density))
    return out


def _by_band(base: Labels, cells: FloatArray, partition: RecordPartition, density: float) -> list[Region]:
    """Fine bands; ``cells`` (K, M) are energies of one channel."""
    energy = _summed(partition.band_of_bin, cells.sum(axis=0), len(partition.bands))
    return [
        Region("band", {**base, "band_hz": list(band)}, chi2, dof * density)
        for band, chi2, dof in zip(partition.bands, energy, partition.band_dof.tolist())
    ]


def _good(mine: RecordFit, channel: int) -> FloatArray:
    """Weight (N,) of the samples of a channel in the degrees of freedom: 0 where bad, with mean 1."""
    if mine.good is None:
        return np.ones(mine.residual.shape[0])
    own = mine.good[:, channel].astype(np.float64)
    return np.asarray(own / max(float(own.mean()), 1e-300))


def _by_time(
    base: Labels, residual: FloatArray, weight: FloatArray, partition: RecordPartition, density: float
) -> list[Region]:
    """Equal windows of time of a residual (N,) whose samples have the ``weight`` (N,) in the degrees of freedom."""
    rate = partition.sample_rate_hz
    edges = np.linspace(0, residual.size, _WINDOWS + 1).round().astype(int).tolist()
    return [
        Region(
            "time",
            {**base, "time_s": [first / rate, stop / rate]},
            float(np.sum(residual[first:stop] ** 2)),
            float(np.sum(weight[first:stop])) * density,
        )
        for first, stop in pairwise(edges)
    ]


def _by_line(
    base: Labels, energies: FloatArray, lines_hz: Sequence[float], resolution_hz: float, density: float
) -> list[Region]:
    """Lines with their energies (one per line) in one channel."""
    half = 0.5 * resolution_hz
    return [
        Region(
            "frequency", {**base, "kind": "line", "band_hz": [float(f - half), float(f + half)]}, chi2, 2.0 * density
        )
        for f, chi2 in zip(lines_hz, energies.tolist())
    ]


def _by_response(
    channel: int, energies: FloatArray, samples: int, partition: RecordPartition, density: float
) -> list[Region]:
    """Levels of the motion of one channel; ``energies`` (B,) of its short blocks of ``samples`` each."""
    level, edges_v = partition.level_of_block[:, channel], partition.level_edges_v[:, channel].tolist()
    energy = _summed(level, energies, LEVELS)
    dof = np.bincount(level, minlength=LEVELS) * samples * density
    sense = f"sense{channel + 1}"
    return [
        Region("response", {"channel": sense, "response_v": edges_v[k : k + 2]}, energy[k], float(dof[k]))
        for k in np.flatnonzero(dof).tolist()
    ]


def _by_label(labels: Mapping[str, object], residual: FloatArray, density: float) -> list[Region]:
    """The whole residual (N,) of one channel of one record, once by each of its labels."""
    chi2, dof = float(np.sum(residual**2)), residual.size * density
    values = {**labels, "level": float(str(labels["level"]))}
    return [Region(name, {name: values[name]}, chi2, dof) for name in ("level", "direction", "channel", "record")]


def _pooled(regions: Sequence[Region]) -> list[Region]:
    """Regions of the same family and labels summed."""
    out: dict[tuple[str, str], Region] = {}
    for region in regions:
        key = (region.family, repr(region.labels))
        known = out.get(key)
        out[key] = (
            region if known is None else replace(known, chi2=known.chi2 + region.chi2, dof=known.dof + region.dof)
        )
    return list(out.values())


def _joined(regions: Sequence[Region]) -> dict[str, object]:
    """Labels of the union of regions: the band [Hz] that contains all of theirs, no record, no channel."""
    bands = np.array([region.labels["band_hz"] for region in regions], dtype=np.float64)
    band = [float(bands[:, 0].min()), float(bands[:, 1].max())]
    return {**regions[0].labels, "record": None, "channel": None, "band_hz": band}


def _base(record: str, channel: int) -> dict[str, object]:
    return {"record": record, "channel": f"sense{channel + 1}"}


def _dof_per_sample(fit: CampaignFit, mine: RecordFit) -> float:
    """Degrees of freedom per sample: 1 less what the nuisances of the record and the parameters of the model took."""
    parameters = len(fit.model.free)
    return mine.dof / mine.residual.size * (1.0 - parameters / max(fit.dof + parameters, 1))


def _summed(index: IntArray, energy: FloatArray, count: int) -> list[float]:
    sums: list[float] = np.bincount(index.reshape(-1), energy.reshape(-1), count).tolist()
    return sums
