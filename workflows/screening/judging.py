"""Judgement of identified devices, and what is kept of their posteriors: all draws of a block of 25 take 17 MB.

Shapes: K common errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.arrays import FloatArray
from pipeline.inference.screening.result import DeviceResult
from pipeline.inference.systematic import Identified, common_nodes
from pipeline.quantities import MODEL
from pipeline.store.schema import posterior_table
from reports.decision import conformity, decide
from reports.limits import Limits

#: Posterior draws at each common error: P(conform) in steps of 1/200, a tenth of the rule's 0.05.
DRAWS_GIVEN_COMMON = 200


@dataclass(frozen=True, eq=False)
class JudgedDevice:
    """A device as it is stored.

    Parameters
    ----------
    columns : of the devices table, by name.
    status : of its estimate.
    draws : columns of the posterior table, by name; empty without draws, ``None`` where none are stored.
    """

    columns: Mapping[str, Any]
    status: str
    draws: Mapping[str, FloatArray] | None


def judged_devices(results: Sequence[DeviceResult], limits: Limits, stored_draws: int) -> list[JudgedDevice]:
    """Devices judged by ``limits``, each with at most ``stored_draws`` posterior draws."""
    verdicts = judged(results, limits)
    return [
        JudgedDevice(
            {**result.columns, **{name: values[i] for name, values in verdicts.items()}},
            result.estimate.status,
            _stored(result, limits, stored_draws) if stored_draws else None,
        )
        for i, result in enumerate(results)
    ]


def judged(results: Sequence[DeviceResult], limits: Limits) -> dict[str, list[Any]]:
    """p_pass, verdict and failed_limits of each result, by column name."""
    unknown = np.full(1, np.nan)
    draws = [{q: result.estimate.draws.get(q, unknown) for q in limits.quantities} for result in results]
    # Devices with equal numbers of draws are judged together.
    alike: dict[tuple[int, ...], list[int]] = {}
    for i, own in enumerate(draws):
        alike.setdefault(tuple(values.size for values in own.values()), []).append(i)
    out: dict[str, list[Any]] = {name: [None] * len(results) for name in ("p_pass", "verdict", "failed_limits")}
    for places in alike.values():
        stacked = {q: np.stack([draws[i][q] for i in places]) for q in limits.quantities}
        found = decide(limits, stacked, [results[i].estimate.status for i in places])
        for i, p_pass, verdict, failed in zip(places, found.p_pass.tolist(), found.verdict, found.failed_limits):
            out["p_pass"][i], out["verdict"][i], out["failed_limits"][i] = p_pass, verdict, failed
    return out


def p_pass_given_common(limits: Limits, identified: Identified, nodes: FloatArray) -> FloatArray:
    """P(conform) (K,) of a device at each of K common errors, ``nodes`` (K, 5) [sd]; nan where it is unknown."""
    count = identified.split_hz.size
    kept = np.linspace(0, count - 1, min(DRAWS_GIVEN_COMMON, count)).round().astype(np.int64)
    draws = identified.thinned(kept).given(np.broadcast_to(nodes[:, None], (nodes.shape[0], kept.size, nodes.shape[1])))
    return conformity(limits, {q: draws[q] for q in limits.quantities}).p_pass


def _stored(result: DeviceResult, limits: Limits, most: int) -> dict[str, FloatArray]:
    """At most ``most`` draws, evenly spaced along the chains, and P(conform) at that many common errors."""
    draws = result.estimate.draws
    if not draws:
        return {}
    total = draws["theta_deg"].size
    kept = np.linspace(0, total - 1, min(most, total)).round().astype(np.int64)
    given = np.full(kept.size, np.nan)
    if result.identified is not None and result.estimate.status == "ok":
        given = p_pass_given_common(limits, result.identified, common_nodes(kept.size))
    return {**{q.name: draws[q.name][kept] for q in MODEL}, "p_pass_given_common": given}


def posterior_of(device_id: Sequence[str], stored: Sequence[Mapping[str, FloatArray] | None]) -> pa.Table:
    """The posterior table of devices with these draws; those without draws have no rows."""
    parts: dict[str, list[Any]] = {
        "device_id": [],
        "draw": [],
        **{q.name: [] for q in MODEL},
        "p_pass_given_common": [],
    }
    for identity, draws in zip(device_id, stored):
        if not draws:
            continue
        count = draws["p_pass_given_common"].size
        parts["device_id"] += [identity] * count
        parts["draw"].append(np.arange(count, dtype=np.int32))
        for name, values in draws.items():
            parts[name].append(values)
    return posterior_table({k: (v if k == "device_id" else np.concatenate(v) if v else []) for k, v in parts.items()})
