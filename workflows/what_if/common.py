"""P(conform to new limits) at each value of the common errors of a tester, from stored draws.

The stored draws contain common errors, node z_i in draw i.  They are taken out again, and each node in turn is put into all:

    measured = stored / (factor of z_i),    at node k: measured (factor of z_k)

As in the run, there is one P(conform) for each of as many nodes as draws are stored.  It is weighted by what the run found at
the same node (``reports.what_if.draws``).  The factors: ``pipeline.inference.systematic``.  Where they multiply all that is
limited, the draws are counted in one loop (``counted``); performance figures are computed anew at each node.

Shapes: K nodes, b devices, n draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.device.gyro import PHYSICAL
from pipeline.inference.estimate import RateSettings, identified_quantities
from pipeline.inference.systematic import Identified, common_factors, common_nodes
from reports.common_errors import GivenCommon
from reports.limits import Limits
from reports.what_if.draws import DrawBatch, reweighted, reweighted_share

from ..screening.judging import DRAWS_GIVEN_COMMON
from .counted import counts
from .stored import StoredDraws


def given_new_limits(
    stored: StoredDraws, wanted: BoolArray, before: GivenCommon | None, old: Limits, new: Limits
) -> GivenCommon | None:
    """P(conform to ``new``) at each common error; ``None`` where the run declares none or stores no draws.

    Parameters
    ----------
    stored : the draws of the run.
    wanted : (B,) whether a device is judged.
    before : P(conform to ``old``) at each common error, as the run found it.
    old, new : limits of the run and new limits.
    """
    rate = stored.rate
    if before is None or rate is None or rate.systematic.exact or stored.per_device == 0:
        return None
    p_pass = np.full(before.p_pass.shape, np.nan)
    for rows, physical, split in stored.physical_batches(wanted):
        count = split.shape[1]
        kept = np.linspace(0, count - 1, min(DRAWS_GIVEN_COMMON, count)).round().astype(np.int64)
        measured = _measured(rate, stored.nodes(count)[kept], physical[:, kept], split[:, kept])
        normal = {q: stored.normal_draws(q, rows, kept.size) for q in stored.normal}
        nodes = common_nodes(min(len(p_pass), count))
        at = (slice(len(nodes)), rows)
        found = _by_factors(stored.names, measured, normal, nodes, before.p_pass[at], old, new)
        if found is None:
            found = _by_figures(DrawBatch(rows, normal), stored.names, measured, nodes, before.p_pass[at], old, new)
        p_pass[at] = found
    return GivenCommon(p_pass, new.rule)


def _by_factors(
    names: Sequence[str],
    measured: Identified,
    normal: Mapping[str, FloatArray],
    nodes: FloatArray,
    p_run: FloatArray,
    old: Limits,
    new: Limits,
) -> FloatArray | None:
    """P (K, b) where the errors multiply all that is limited; ``None`` for figures, and where draws are nan."""
    values = {**identified_quantities(measured.physical, measured.rate, measured.split_hz), **normal}
    terms = {q: found for q, found in common_factors(measured.rate, nodes).items() if q in names and q not in normal}
    used = {*names, *(base for found in terms.values() for base, _ in found)}
    if not used <= values.keys() or not terms or any(np.isnan(values[name]).any() for name in used):
        return None
    found = counts({name: values[name] for name in used}, terms, old, new)
    return reweighted_share(measured.split_hz.shape[1], found.old, found.new, found.both, p_run, old, new)


def _by_figures(
    batch: DrawBatch,
    names: Sequence[str],
    measured: Identified,
    nodes: FloatArray,
    p_run: FloatArray,
    old: Limits,
    new: Limits,
) -> FloatArray:
    """P (K, b) of any quantities, each computed at each node; ``batch`` has the normal ones."""
    found = []
    for z, p in zip(nodes, p_run, strict=True):
        values = measured.given(np.broadcast_to(z, (*measured.split_hz.shape, z.size))) | dict(batch.values)
        found.append(reweighted(DrawBatch(batch.rows, {name: values[name] for name in names}), p, old, new).p_pass)
    return np.array(found)


def _measured(rate: RateSettings, nodes: FloatArray, physical: FloatArray, split: FloatArray) -> Identified:
    """The draws (b, n, 12) and splits (b, n) as the tester measured them, without their common errors ``nodes`` (n, 5)."""
    # The errors multiply, so what they make of ones is their factors.
    ones = Identified(np.ones_like(physical[:1]), np.ones_like(split[:1]), replace(rate, angular_gain=None))
    factor = ones.given(np.expand_dims(nodes, 0))
    moved = np.stack([factor[name] for name in PHYSICAL], axis=-1)
    return Identified(physical / moved, split / factor["split_hz"], rate)
