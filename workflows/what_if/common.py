"""P(conform to new limits) at each value of the common errors of a tester, from stored draws.

The stored draws contain common errors, node z_i in draw i.  They are taken out again, and each node in turn is put into all:

    measured = stored / (factor of z_i),    at node k: measured (factor of z_k)

As in the run, there is one P(conform) for each of as many nodes as draws are stored.  It is weighted by what the run found at
the same node (``reports.what_if.draws``).  The factors: ``pipeline.inference.systematic``.

Shapes: K nodes, b devices, n draws.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.device.gyro import PHYSICAL
from pipeline.inference.estimate import RateSettings
from pipeline.inference.systematic import Identified, common_nodes
from reports.common_errors import GivenCommon
from reports.limits import Limits
from reports.what_if.draws import DrawBatch, reweighted

from ..screening.block import DRAWS_GIVEN_COMMON
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
        for k, z in enumerate(common_nodes(min(len(p_pass), count))):
            values = measured.given(np.broadcast_to(z, (rows.size, kept.size, z.size)))
            values |= {q: stored.normal_draws(q, rows, kept.size) for q in stored.normal}
            batch = DrawBatch(rows, {name: values[name] for name in stored.names})
            p_pass[k, rows] = reweighted(batch, before.p_pass[k, rows], old, new).p_pass
    return GivenCommon(p_pass, new.rule)


def _measured(rate: RateSettings, nodes: FloatArray, physical: FloatArray, split: FloatArray) -> Identified:
    """The draws (b, n, 12) and splits (b, n) as the tester measured them, without their common errors ``nodes`` (n, 5)."""
    # The errors multiply, so what they make of ones is their factors.
    ones = Identified(np.ones_like(physical[:1]), np.ones_like(split[:1]), replace(rate, angular_gain=None))
    factor = ones.given(np.expand_dims(nodes, 0))
    moved = np.stack([factor[name] for name in PHYSICAL], axis=-1)
    return Identified(physical / moved, split / factor["split_hz"], rate)
