"""Where a model fails, as rows of plain values for JSON, tables and pages.

    share   of the misfit beyond the noise in the row's family;  families are told apart by the key "family"
    error   rms of the residual there, in sigmas; 1 is the noise

The family "frequency" holds the kinds resonance, harmonic, line and broadband: their shares add up to one together.  Every other
family (its kind has its name) adds up to one by itself.  Rows are significant ones; "where_rest" is what the others hold.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...criticism.problem import Region
from ...criticism.regions import where
from .regions import FAMILIES, FREQUENCY_KINDS

#: Rows a family, and the least share of a row.
_SHOWN, _LEAST = 12, 1e-3
#: Family-wise probability of telling a region that is noise.
ALPHA = 0.003
_WHOLE = ("level", "direction", "channel", "record")
_KEYS = ("record", "channel", "band_hz", "time_s", "harmonic", "level", "response_v", "direction")

Row = dict[str, Any]


def where_rows(regions: Sequence[Region], noise_dof: float) -> list[Row]:
    """Significant regions of every family, the largest first, families in their order.

    A family of a few regions that cut the whole campaign is told whole as soon as one of them is significant.
    """
    found = where(regions, np.inf, noise_dof)
    rows: list[Row] = []
    for family in FAMILIES:
        own = [w for w in found if w.family == family]
        told = [w for w in own if w.p_value < ALPHA and w.share >= _LEAST]
        if told and family in _WHOLE:
            told = own
        rows += [_row(w.family, w.labels, w.share, w.error) for w in told[:_SHOWN]]
    return rows


def where_rest(rows: Sequence[Row]) -> dict[str, float]:
    """What is not in any row, by family; families without rows are left out."""
    told = {str(row["family"]) for row in rows}
    sums = {f: sum(float(row["share"]) for row in rows if row["family"] == f) for f in FAMILIES if f in told}
    return {family: max(1.0 - total, 0.0) for family, total in sums.items()}


def by_kind(regions: Sequence[Region]) -> list[Region]:
    """The cut by frequency with all records and channels together: kinds, harmonics by their order, bands and lines."""
    pooled: dict[tuple[Any, ...], list[Region]] = {}
    for region in regions:
        if region.family == "frequency":
            labels = region.labels
            # Bands of a kind differ a little with the drive; harmonics are one whatever their band.
            place = None if labels["kind"] in ("harmonic", "broadband") else str(labels["band_hz"])
            pooled.setdefault((labels["kind"], labels.get("harmonic"), place), []).append(region)
    return [
        Region("frequency", _joined(own), sum(r.chi2 for r in own), sum(r.dof for r in own)) for own in pooled.values()
    ]


def _joined(regions: Sequence[Region]) -> dict[str, object]:
    bands = np.array([region.labels["band_hz"] for region in regions], dtype=np.float64)
    first = dict(regions[0].labels)
    first.update(record=None, channel=None, band_hz=[float(bands[:, 0].min()), float(bands[:, 1].max())])
    return first


def with_after(rows: Sequence[Row], before: Sequence[Region], after: Sequence[Region]) -> list[Row]:
    """``rows`` of ``before`` with the error that ``after`` leaves there, and the share of the row's excess that it explains."""
    first, last = ({_key(r.family, r.labels): r for r in regions} for regions in (before, after))
    out = []
    for row in rows:
        key = _key(str(row["family"]), row)
        old, new = first.get(key), last.get(key)
        if old is None or new is None:
            out.append(row)
            continue
        out.append({**row, "error_after": math.sqrt(new.chi2 / new.dof), "explained": explained_share([old], [new])})
    return out


def explained_share(before: Sequence[Region], after: Sequence[Region]) -> float:
    """1 - excess after / excess before, at most 1."""
    old, new = (sum(r.chi2 - r.dof for r in regions) for regions in (before, after))
    return min(1.0 - new / old, 1.0) if old > 0.0 else 0.0


def explained_by_kind(before: Sequence[Region], after: Sequence[Region], kinds: Sequence[str]) -> dict[str, float]:
    """``explained_share`` of the kinds that the cut by frequency had."""
    out = {}
    for kind in FREQUENCY_KINDS:
        if kind in kinds:
            of = [[r for r in regions if r.labels.get("kind") == kind] for regions in (before, after)]
            out[kind] = explained_share(of[0], of[1])
    return out


def _key(family: str, labels: Mapping[str, Any]) -> tuple[str, str]:
    values = [_plain(labels.get(name)) for name in _KEYS]
    own = labels.get("kind") if family == "frequency" else family
    return family, repr((own, values))


def _row(family: str, labels: Mapping[str, Any], share: float, error: float) -> Row:
    row: Row = {"family": family, "kind": labels.get("kind", family), "record": None, "channel": None}
    row |= {"band_hz": None, "time_s": None}
    row |= {name: _plain(value) for name, value in labels.items() if name in _KEYS}
    return {**row, "share": float(share), "error": float(error)}


def _plain(value: object) -> object:
    """Spans to six digits: edges lie on bins, whose further digits say nothing."""
    return [float(f"{end:.6g}") for end in value] if isinstance(value, list) else value
