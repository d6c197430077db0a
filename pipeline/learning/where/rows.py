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
from ...criticism.regions import ALPHA, region_shares
from .regions import FAMILIES, explained

#: Rows a family, and the least share of a row.
_SHOWN, _LEAST = 12, 1e-3
_WHOLE = ("level", "direction", "channel", "record")
_KEYS = ("record", "channel", "band_hz", "time_s", "harmonic", "level", "response_v", "direction")

Row = dict[str, Any]


def where_rows(regions: Sequence[Region], noise_dof: float) -> list[Row]:
    """Significant regions of every family, the largest first, families in their order.

    A family of a few regions that cut the whole campaign is told whole as soon as one of them is significant.
    """
    found = region_shares(regions, np.inf, noise_dof)
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
        out.append({**row, "error_after": math.sqrt(new.chi2 / new.dof), "explained": explained([old], [new])})
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
