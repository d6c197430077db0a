"""Where a model fails, as ``Place`` objects: significant regions of the residual, the largest first.

    share   of the misfit beyond the noise in the region's family
    error   rms of the residual there, in sigmas; 1 is the noise

The family "frequency" holds the kinds resonance, harmonic, line and broadband; their shares together add up to one.  In every
other family (its kind has the same name) the shares add up to one as well, because it partitions the same residual in another
way.  ``where_rest`` is the share of each family that is in no significant region.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from ...criticism.problem import Region
from ...criticism.regions import ALPHA, region_shares
from ..answers import Place, place_at
from .regions import FAMILIES, explained

#: Largest number of places per family, and the smallest share that is reported.
_MOST, _LEAST_SHARE = 12, 1e-3
#: Families of a few regions each: all of them are reported as soon as one is significant.
_WHOLE = ("level", "direction", "channel", "record")
_LABELS = ("record", "channel", "band_hz", "time_s", "harmonic", "level", "response_v", "direction")


def where_rows(regions: Sequence[Region], noise_dof: float) -> tuple[Place, ...]:
    """Significant regions of every family, the largest first, families in the order of ``FAMILIES``.

    Parameters
    ----------
    regions : the residual, partitioned by every family.
    noise_dof : degrees of freedom of the noise level.
    """
    found = region_shares(regions, np.inf, noise_dof)
    places: list[Place] = []
    for family in FAMILIES:
        own = [w for w in found if w.family == family]
        significant = [w for w in own if w.p_value < ALPHA and w.share >= _LEAST_SHARE]
        if significant and family in _WHOLE:
            significant = own
        places += [_place(w.family, w.labels, w.share, w.error) for w in significant[:_MOST]]
    return tuple(places)


def where_rest(places: Sequence[Place]) -> dict[str, float]:
    """The share of each family that is in no place; families without a place are left out."""
    present = {place.family for place in places}
    sums = {f: sum(place.share for place in places if place.family == f) for f in FAMILIES if f in present}
    return {family: max(1.0 - total, 0.0) for family, total in sums.items()}


def with_after(places: Sequence[Place], before: Sequence[Region], after: Sequence[Region]) -> tuple[Place, ...]:
    """``places`` of ``before``, each with the error that ``after`` leaves there and the share of its excess that it explains."""
    first, last = ({_location(_place(r.family, r.labels)): r for r in regions} for regions in (before, after))
    out = []
    for place in places:
        old, new = first.get(_location(place)), last.get(_location(place))
        if old is not None and new is not None:
            left = math.sqrt(new.chi2 / new.dof)
            place = replace(place, error_after=left, explained=explained([old], [new]))
        out.append(place)
    return tuple(out)


def _location(place: Place) -> tuple[object, ...]:
    return (place.family, place.kind, *(getattr(place, name) for name in _LABELS))


def _place(family: str, labels: Mapping[str, object], share: float = 0.0, error: float = 0.0) -> Place:
    known = {"kind": family, "time_s": None, **{name: _rounded(value) for name, value in labels.items()}}
    return place_at(known, family=family, share=float(share), error=float(error))


def _rounded(value: object) -> object:
    """Intervals to six digits: their edges lie on bins of the spectrum, whose further digits carry no information."""
    return tuple(float(f"{end:.6g}") for end in value) if isinstance(value, list | tuple) else value
