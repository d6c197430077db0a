"""Effects that the devices of a run or of a lot share, and effects of single misfits.

    flagged devices + a sample of ok devices --examine--> scores --criticism.shared--> an effect that the lot needs?
      --refit with it, examine again--> .. until no further effect is found --> each remaining misfit by itself

The result depends on the configuration and the devices table only, not on workers, blocks or resumption.  The sampled devices
represent all devices with status ok; if they show an effect that is not yet significant, the sample is enlarged.

Shapes: n examined devices, K columns of all candidate effects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.criticism.prevalence import prevalence
from pipeline.criticism.shared import Evidence, Shared, shared
from reports.devices import ColumnSource
from reports.run.lot_effects import LotEffect, LotEffects, ParameterSize

from ...config_tables import DiagnosisTable
from .device import DeviceExamination, Request, columns_of, sizes_of
from .scope import (
    SIGNIFICANT_SD,
    LotDevice,
    Scope,
    bounds_of,
    devices_of,
    lacks,
    lots_alternating,
    needed_in,
    parameters_of,
    scopes_of,
    sizes_in,
)

#: Examines devices, in any order.
Examiner = Callable[[Sequence[Request]], Iterable[DeviceExamination]]
Examined = dict[int, DeviceExamination]
Columns = dict[str, dict[str, Any]]
Found = dict[str, Shared]

#: Largest number of effects added one after the other.
_RUNGS = 3
#: The sample is enlarged in at most this many stages, by this factor, while the family-wise p is below the last number.
_STAGES, _GROWTH, _HINT = 4, 4, 0.2
#: Number of flagged devices of a lot that are scored again after an effect was added; all are refitted.
_SCORED = 24


def examine(table: ColumnSource, rules: DiagnosisTable, examiner: Examiner) -> tuple[LotEffects, Columns]:
    """Examine the misfits of a run.

    Parameters
    ----------
    table : ``devices`` of the whole run, in order.
    rules : how many devices to examine, and alpha.
    examiner : examines devices.

    Returns
    -------
    The findings, and device_id -> columns to amend.
    """
    devices = devices_of(table)
    scopes = scopes_of(devices)
    flagged = [device for device in devices if device.flagged][: rules.most]
    ok = lots_alternating([device for device in devices if not device.flagged])
    wanted = max(12, len(ok) // 50) if rules.sample is None else rules.sample
    examined: Examined = {}
    found: Found = {}
    for _ in range(_STAGES):
        group = [*flagged, *ok[:wanted]]
        examined |= _results(examiner, [Request(d.number, d.start) for d in group if d.number not in examined])
        found, nearest = _best(scopes, examined, rules.alpha)
        if found or nearest[1] > np.log(_HINT) or wanted >= len(ok) or rules.sample is not None:
            break
        wanted *= _GROWTH
    group = [*flagged, *ok[:wanted]]
    terms: dict[str, tuple[str, ...]] = {}
    evidence: dict[tuple[str, str], Shared] = {}
    for _ in range(_RUNGS):
        if not found:
            break
        for lot, result in found.items():
            assert result.found is not None
            terms[lot] = (*terms.get(lot, ()), result.found.name)
            evidence[lot, result.found.name] = result
        examined = _reexamined(examiner, group, examined, terms)
        terms = _pruned(scopes, examined, terms, rules.alpha)
        examined = _reexamined(examiner, group, examined, terms)
        found, nearest = _best(scopes, examined, rules.alpha)
        if any(result.found is not None and (lot, result.found.name) in evidence for lot, result in found.items()):
            break
    columns = _columns(examiner, group, examined, terms, evidence)
    effects = tuple(
        _effect(scope, name, evidence[scope.lot, name], scopes, examined)
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


def _results(examiner: Examiner, requests: Sequence[Request]) -> Examined:
    """Examinations by device number, in the order of the numbers."""
    found = {result.number: result for result in examiner(requests)} if requests else {}
    return dict(sorted(found.items()))


def _terms_of(device: LotDevice, terms: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Effects in the model of a device: those of the run and of its lot."""
    return tuple(sorted({*terms.get("", ()), *terms.get(device.lot, ())}))


def _reexamined(
    examiner: Examiner, group: Sequence[LotDevice], examined: Examined, terms: Mapping[str, tuple[str, ...]]
) -> Examined:
    """Examinations with ``terms`` in the models; devices whose terms have changed are examined again."""
    counts: dict[str, int] = {}
    requests = []
    for device in group:
        counts[device.lot] = counts.get(device.lot, 0) + device.flagged
        wanted = _terms_of(device, terms)
        if examined[device.number].terms != wanted:
            start = _start(device, examined[device.number], wanted)
            scored = not device.flagged or counts[device.lot] <= _SCORED
            requests.append(Request(device.number, start, wanted, scored=scored))
    return dict(sorted((examined | _results(examiner, requests)).items()))


def _start(device: LotDevice, last: DeviceExamination, wanted: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Start of a fit with the terms ``wanted``: the last fit, and one scoring step for the sizes of new terms."""
    start = dict(device.start) | {name: value for name, (value, _) in last.parameters.items()}
    for term in columns_of(last.terms) if last.score.size else ():
        if term.name in wanted:
            own = list(term.columns)
            step = np.linalg.pinv(last.information[np.ix_(own, own)], hermitian=True) @ last.score[own]
            for (full, _, null), (low, high), value in zip(
                parameters_of(term.name), bounds_of(term.name), step.tolist()
            ):
                start[full] = min(max(null + value, low), high)
    return tuple(start.items())


def _best(scopes: Sequence[Scope], examined: Examined, alpha: float) -> tuple[Found, tuple[str, float]]:
    """The effect that the whole run shares, else those that single lots share, by lot.

    Also the most significant effect of the whole run and the log of its family-wise p.
    """
    trials = float(len(scopes) * _STAGES)
    nearest = ("", 0.0)
    found: Found = {}
    for scope in scopes:
        result = _shared(scope, examined, alpha, trials)
        if result is None:
            continue
        if scope.lot == "":
            nearest = (result.nearest, result.log_p_any)
        if result.found is not None and "" not in found:
            found[scope.lot] = result
    return found, nearest


def _shared(scope: Scope, examined: Examined, alpha: float, trials: float) -> Shared | None:
    """The joint test of the examined devices of a scope that have the most frequent set of terms in their model."""
    weights = scope.weights({n: one for n, one in examined.items() if one.score.size})
    by_terms: dict[tuple[str, ...], list[int]] = {}
    for number in sorted(weights):
        by_terms.setdefault(examined[number].terms, []).append(number)
    if not by_terms:
        return None
    terms, numbers = max(by_terms.items(), key=lambda item: (len(item[1]), item[0]))
    evidence = Evidence(
        np.stack([examined[n].score for n in numbers]),
        np.stack([examined[n].information for n in numbers]),
        np.stack([examined[n].covariance for n in numbers]),
        np.array([weights[n] for n in numbers]),
    )
    return shared(evidence, columns_of(terms), scope.population, alpha, trials)


def _pruned(
    scopes: Sequence[Scope], examined: Examined, terms: Mapping[str, tuple[str, ...]], alpha: float
) -> dict[str, tuple[str, ...]]:
    """The terms whose fitted sizes are still significant, and the last one added."""
    by_lot = {scope.lot: scope for scope in scopes}
    return {
        lot: tuple(
            name for i, name in enumerate(own) if i == len(own) - 1 or needed_in(by_lot[lot], examined, name, alpha)
        )
        for lot, own in terms.items()
    }


def _columns(
    examiner: Examiner,
    group: Sequence[LotDevice],
    examined: Examined,
    terms: Mapping[str, tuple[str, ...]],
    evidence: Mapping[tuple[str, str], Shared],
) -> Columns:
    """The columns of each examined device; devices that are still misfits are diagnosed by themselves."""
    left = [device for device in group if device.flagged and examined[device.number].status != "ok"]
    requests = []
    for device in left:
        wanted = _terms_of(device, terms)
        requests.append(Request(device.number, _start(device, examined[device.number], wanted), wanted, alone=True))
    alone = _results(examiner, requests)
    rivals = {name: result.rivals for (_, name), result in evidence.items()}
    out: Columns = {}
    for device in group:
        result, wanted = examined[device.number], _terms_of(device, terms)
        own: dict[str, Any] = {}
        if wanted:
            own = {
                "status_with_effects": result.status,
                "p_pass_with_effects": result.p_pass,
                "verdict_with_effects": result.verdict,
            }
        significant = [name for name in wanted if _significant(result, name)]
        shared_effects = "+".join("|".join((name, *rivals[name])) for name in significant)
        if device.number in alone:
            last = alone[device.number]
            # If the device remains unexplained, its fit with the lot's effects is no evidence for them.
            missing = "unknown" if last.effects == "unknown" else "+".join(filter(None, (shared_effects, last.effects)))
            sizes = ", ".join(filter(None, (sizes_of(result.parameters, significant), last.sizes)))
            own |= _missing_columns(missing, sizes, last.reason or last.why)
        elif significant:
            own |= _missing_columns(shared_effects, sizes_of(result.parameters, significant), "effect of the lot")
        if own:
            out[device.device_id] = own
    return out


def _missing_columns(missing: str, sizes: str, reason: str) -> dict[str, Any]:
    return {
        "missing_effect": missing or None,
        "missing_effect_size": sizes or None,
        "missing_effect_reason": reason or None,
    }


def _significant(result: DeviceExamination, name: str) -> bool:
    """Whether the size of an effect is significant in this device alone."""
    for full, _, null in parameters_of(name):
        value, sd = result.parameters.get(full, (null, float("nan")))
        if abs(value - null) > SIGNIFICANT_SD * sd:
            return True
    return False


def _effect(scope: Scope, name: str, evidence: Shared, scopes: Sequence[Scope], examined: Examined) -> LotEffect:
    """An effect that a scope needs, with its prevalence and its sizes from the refits.

    The prevalence is that of the parameter with the largest mean size over sd.
    """
    assert evidence.found is not None
    rows, best, largest = [], None, -1.0
    for full, unit, null in parameters_of(name):
        values, sds, weights = sizes_in(scope, examined, full, null)
        found = prevalence(values, sds, weights)
        rows.append(ParameterSize(full.partition(".")[2], unit, found.mean, found.mean_sd, found.spread))
        with np.errstate(invalid="ignore", divide="ignore"):
            strength = float(np.nanmean(np.abs(values) / sds)) if values.size else 0.0
        if strength > largest:
            best, largest = found, strength
    assert best is not None
    lots = scopes[1:] if scope.lot == "" else ()
    inside = tuple(one.lot for one in lots if not lacks(one, examined, name, rows))
    return LotEffect(
        name,
        evidence.rivals,
        scope.lot,
        inside if len(inside) < len(lots) else (),
        best.share,
        best.low,
        best.high,
        tuple(rows),
        evidence.found.log_p,
        evidence.found.log_p_without,
        len(evidence.aside),
    )
