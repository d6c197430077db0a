"""After the last block: what do misfits lack, and do the devices of a lot share it?

    flagged devices + a sample of ok ones --look--> scores --criticism.shared--> an effect that the lot needs?
      --refit with it, look again--> .. until no further one is found --> what is left of each flagged device, by itself

Everything follows from the configuration and the devices table, in the order of device names' hashes: the same findings
whatever the workers, blocks or resume.  Sampled devices stand for all that are ok; where they hint at something that they
cannot prove, the sample is enlarged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.criticism.prevalence import prevalence
from pipeline.criticism.shared import Evidence, Shared, shared
from reports.run.lot_effects import LotEffect, LotEffects, ParameterSize

from ...config_tables import DiagnosisTable
from .device import DeviceExamination, Request, columns_of, sizes_of
from .scope import (
    SEEN,
    LotDevice,
    Scope,
    bounds_of,
    devices_of,
    in_turn,
    lacks,
    needed_in,
    parameters_of,
    scopes_of,
    sizes_in,
)

Looker = Callable[[Sequence[Request]], Iterable[DeviceExamination]]
Columns = dict[str, dict[str, Any]]
Found = dict[str, Shared]

_RUNGS = 3
#: The sample is enlarged at most so many times, by this factor, while chance would give as much more rarely than this.
_STAGES, _GROWTH, _HINT = 4, 4, 0.2
#: So many flagged devices of a lot are scored again once effects have been added; all are refitted.
_SCORED = 24


def examine(table: pa.Table, rules: DiagnosisTable, look: Looker) -> tuple[LotEffects, Columns]:
    """Examine the misfits of a run.

    Parameters
    ----------
    table : ``devices`` of the whole run, in order.
    rules : how many to examine, and alpha.
    look : looks at devices, in any order.

    Returns
    -------
    What was found, and device_id -> columns to amend.
    """
    devices = devices_of(table)
    scopes = scopes_of(devices)
    flagged = [device for device in devices if device.flagged][: rules.most]
    ok = in_turn([device for device in devices if not device.flagged])
    wanted = max(12, len(ok) // 50) if rules.sample is None else rules.sample
    looks: dict[int, DeviceExamination] = {}
    found: Found = {}
    for _ in range(_STAGES):
        group = [*flagged, *ok[:wanted]]
        looks |= _looked(look, [Request(d.number, d.start) for d in group if d.number not in looks])
        found, nearest = _best(scopes, looks, {}, rules.alpha)
        if found or nearest[1] > np.log(_HINT) or wanted >= len(ok) or rules.sample is not None:
            break
        wanted *= _GROWTH
    group = [*flagged, *ok[:wanted]]
    terms: dict[str, tuple[str, ...]] = {}
    evidence: dict[tuple[str, str], Shared] = {}
    for _ in range(_RUNGS):
        if not found:
            break
        for lot, seen in found.items():
            assert seen.found is not None
            terms[lot] = (*terms.get(lot, ()), seen.found.name)
            evidence[lot, seen.found.name] = seen
        looks = _relooked(look, group, looks, terms)
        terms = _pruned(scopes, looks, terms, rules.alpha)
        looks = _relooked(look, group, looks, terms)
        found, nearest = _best(scopes, looks, terms, rules.alpha)
        if any(seen.found is not None and (lot, seen.found.name) in evidence for lot, seen in found.items()):
            break
    columns = _columns(look, group, looks, terms, evidence)
    effects = tuple(
        _effect(scope, name, evidence[scope.lot, name], scopes, looks)
        for scope in scopes
        for name in terms.get(scope.lot, ())
    )
    summary = LotEffects(
        rules.alpha,
        len(scopes[0].flagged),
        len(flagged),
        len(group) - len(flagged),
        len(ok),
        sum("status_with_effects" in own for own in columns.values()),
        effects,
        *nearest,
    )
    return summary, columns


def _looked(look: Looker, requests: Sequence[Request]) -> dict[int, DeviceExamination]:
    found = {seen.number: seen for seen in look(requests)} if requests else {}
    return dict(sorted(found.items()))


def _terms_of(device: LotDevice, terms: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Effects in the model of a device: those of the run and of its lot."""
    return tuple(sorted({*terms.get("", ()), *terms.get(device.lot, ())}))


def _relooked(
    look: Looker, group: Sequence[LotDevice], looks: dict[int, DeviceExamination], terms: Mapping[str, tuple[str, ...]]
) -> dict[int, DeviceExamination]:
    """Looks with the terms in the models, anew where they differ."""
    counts: dict[str, int] = {}
    requests = []
    for device in group:
        counts[device.lot] = counts.get(device.lot, 0) + device.flagged
        wanted = _terms_of(device, terms)
        if looks[device.number].terms != wanted:
            start = _start(device, looks[device.number], wanted)
            scored = not device.flagged or counts[device.lot] <= _SCORED
            requests.append(Request(device.number, start, wanted, scored=scored))
    return dict(sorted((looks | _looked(look, requests)).items()))


def _start(device: LotDevice, seen: DeviceExamination, wanted: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Where a fit with the terms ``wanted`` starts: the fit that was made, and one step to the sizes of new terms."""
    start = dict(device.start) | {name: value for name, (value, _) in seen.parameters.items()}
    for term in columns_of(seen.terms) if seen.score.size else ():
        if term.name in wanted:
            own = list(term.columns)
            step = np.linalg.pinv(seen.information[np.ix_(own, own)], hermitian=True) @ seen.score[own]
            for (full, _, null), (low, high), value in zip(
                parameters_of(term.name), bounds_of(term.name), step.tolist()
            ):
                start[full] = min(max(null + value, low), high)
    return tuple(start.items())


def _best(
    scopes: Sequence[Scope], looks: Mapping[int, DeviceExamination], terms: Mapping[str, tuple[str, ...]], alpha: float
) -> tuple[Found, tuple[str, float]]:
    """What the whole run shares, else what single lots share; and what came nearest."""
    trials = float(len(scopes) * _STAGES)
    nearest = ("", 0.0)
    found: Found = {}
    for scope in scopes:
        seen = _shared(scope, looks, alpha, trials)
        if seen is None:
            continue
        if scope.lot == "":
            nearest = (seen.nearest, seen.log_p_any)
        if seen.found is not None and "" not in found:
            found[scope.lot] = seen
    return found, nearest


def _shared(scope: Scope, looks: Mapping[int, DeviceExamination], alpha: float, trials: float) -> Shared | None:
    """What the examined devices of a scope say together; those with other terms in their model than most are left out."""
    weights = scope.weights({n: one for n, one in looks.items() if one.score.size})
    by_terms: dict[tuple[str, ...], list[int]] = {}
    for number in sorted(weights):
        by_terms.setdefault(looks[number].terms, []).append(number)
    if not by_terms:
        return None
    terms, numbers = max(by_terms.items(), key=lambda item: (len(item[1]), item[0]))
    evidence = Evidence(
        np.stack([looks[n].score for n in numbers]),
        np.stack([looks[n].information for n in numbers]),
        np.stack([looks[n].covariance for n in numbers]),
        np.array([weights[n] for n in numbers]),
    )
    return shared(evidence, columns_of(terms), scope.population, alpha, trials)


def _pruned(
    scopes: Sequence[Scope], looks: Mapping[int, DeviceExamination], terms: Mapping[str, tuple[str, ...]], alpha: float
) -> dict[str, tuple[str, ...]]:
    """Terms whose fitted sizes still say that they are needed; the last one added is always kept."""
    by_lot = {scope.lot: scope for scope in scopes}
    return {
        lot: tuple(
            name for i, name in enumerate(own) if i == len(own) - 1 or needed_in(by_lot[lot], looks, name, alpha)
        )
        for lot, own in terms.items()
    }


def _columns(
    look: Looker,
    group: Sequence[LotDevice],
    looks: Mapping[int, DeviceExamination],
    terms: Mapping[str, tuple[str, ...]],
    evidence: Mapping[tuple[str, str], Shared],
) -> Columns:
    """What is written of each examined device; those that are still misfits are diagnosed by themselves."""
    left = [device for device in group if device.flagged and looks[device.number].status != "ok"]
    requests = []
    for device in left:
        wanted = _terms_of(device, terms)
        requests.append(Request(device.number, _start(device, looks[device.number], wanted), wanted, alone=True))
    alone = _looked(look, requests)
    rivals = {name: seen.rivals for (_, name), seen in evidence.items()}
    out: Columns = {}
    for device in group:
        seen, wanted = looks[device.number], _terms_of(device, terms)
        own: dict[str, Any] = {}
        if wanted:
            own = {
                "status_with_effects": seen.status,
                "p_pass_with_effects": seen.p_pass,
                "verdict_with_effects": seen.verdict,
            }
        visible = [name for name in wanted if _visible(seen, name)]
        carried_by = "+".join("|".join((name, *rivals[name])) for name in visible)
        if device.number in alone:
            last = alone[device.number]
            # A failed refit with the lot's effects says nothing about them.
            missing = "unknown" if last.effects == "unknown" else "+".join(filter(None, (carried_by, last.effects)))
            sizes = ", ".join(filter(None, (sizes_of(seen.parameters, visible), last.sizes)))
            own |= _told(missing, sizes, last.reason or last.why)
        elif visible:
            own |= _told(carried_by, sizes_of(seen.parameters, visible), "effect of the lot")
        if own:
            out[device.device_id] = own
    return out


def _told(missing: str, sizes: str, reason: str) -> dict[str, Any]:
    return {
        "missing_effect": missing or None,
        "missing_effect_size": sizes or None,
        "missing_effect_reason": reason or None,
    }


def _visible(seen: DeviceExamination, name: str) -> bool:
    """Whether an effect's size is seen in this device by itself."""
    for full, _, null in parameters_of(name):
        value, sd = seen.parameters.get(full, (null, float("nan")))
        if abs(value - null) > SEEN * sd:
            return True
    return False


def _effect(
    scope: Scope, name: str, seen: Shared, scopes: Sequence[Scope], looks: Mapping[int, DeviceExamination]
) -> LotEffect:
    """An effect that a scope needs, with who carries it and how much of it, from the refits."""
    assert seen.found is not None
    rows, best, telling = [], None, -1.0
    for full, unit, null in parameters_of(name):
        values, sds, weights = sizes_in(scope, looks, full, null)
        told = prevalence(values, sds, weights)
        rows.append(ParameterSize(full.partition(".")[2], unit, told.mean, told.mean_sd, told.spread))
        with np.errstate(invalid="ignore", divide="ignore"):
            strength = float(np.nanmean(np.abs(values) / sds)) if values.size else 0.0
        if strength > telling:
            best, telling = told, strength
    assert best is not None
    lots = scopes[1:] if scope.lot == "" else ()
    inside = tuple(one.lot for one in lots if not lacks(one, looks, name, rows))
    return LotEffect(
        name,
        seen.rivals,
        scope.lot,
        inside if len(inside) < len(lots) else (),
        best.share,
        best.low,
        best.high,
        tuple(rows),
        seen.found.log_p,
        seen.found.log_p_without,
        len(seen.aside),
    )
