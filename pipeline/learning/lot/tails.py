"""Tests of single devices: a share of them is changed, or the tails are heavier than normal.

    mixture     t_i = a_i' C_i^-1 e_i / sqrt(a_i' C_i^-1 a_i)       number of t_i above ``BEYOND``, binomial
    outliers    e_i' C_i^-1 e_i                                     the same, chi-square
    heavy tail  kurtosis of z, per quantity

e_i and C_i are the left-out residual of a device and its covariance, a_i the change.  Shapes: n devices, q quantities.
Source: Anscombe, Glynn, Biometrika 70 (1983) 227 (kurtosis test).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import binom, chi2, kurtosistest, norm

from ...arrays import BoolArray, FloatArray
from .family import family_wise
from .measured import MeasuredLot
from .outcome import LeftOut
from .population import DeviceMixture
from .scores import LotScore

#: sds beyond which a device counts; half a device of 1000 lies there by chance.
BEYOND = 3.29
OUTLIERS = "outliers"
#: Devices that a kurtosis needs.
FOR_KURTOSIS = 50
#: sd of an outlier over the spread of a device.
OUTLYING = 10.0


def outliers(lot: MeasuredLot, scale: FloatArray) -> DeviceMixture:
    """A few devices whose quantities are anything: ``OUTLYING`` times the spread ``scale`` (q,)."""
    n, q = lot.values.shape
    columns = np.broadcast_to(np.diag(OUTLYING * scale), (n, q, q)).copy()
    return DeviceMixture(OUTLIERS, np.zeros((n, q)), columns, 0.01)


def mixture_scores(out: LeftOut, mixtures: Sequence[DeviceMixture]) -> tuple[LotScore, ...]:
    """One score for each absent mixture, family-wise among them."""
    found = []
    tail = float(norm.sf(BEYOND))
    for mixture in mixtures:
        if np.any(mixture.mean):
            weighted = np.linalg.solve(out.covariance, (mixture.mean * out.seen)[..., None])[..., 0]
            size = np.einsum("nq,nq->n", weighted, mixture.mean * out.seen)
            t = np.einsum("nq,nq->n", weighted, out.residual) / np.sqrt(np.where(size > 0.0, size, 1.0))
            beyond = (t > BEYOND) & (size > 0.0)
        else:
            beyond = out.squared > chi2.isf(tail, out.seen.sum(axis=1))
        count = int(beyond.sum())
        log_p = float(binom.logsf(count - 1, beyond.size, tail)) if count else 0.0
        z = (count - beyond.size * tail) / np.sqrt(beyond.size * tail)
        found.append(LotScore(mixture.name, float(z), log_p, family_wise(log_p, len(mixtures)), 1.0))
    return tuple(found)


def tail_scores(lot: MeasuredLot, out: LeftOut, apart: BoolArray) -> tuple[LotScore, ...]:
    """Probes: heavy tails of each quantity, family-wise among them, without the devices ``apart`` (n,).

    Devices of a mixture are left out, because their own law (a leak, which has a lower end) is normal only to first order.
    """
    z = np.where(apart[:, None], np.nan, out.z)
    rows = []
    for k, quantity in enumerate(lot.quantities):
        own = z[np.isfinite(z[:, k]), k]
        if own.size >= FOR_KURTOSIS:
            value = float(kurtosistest(own).statistic)
            rows.append((f"heavy_tail({quantity})", value, float(norm.logsf(value))))
    return tuple(LotScore(name, value, log_p, family_wise(log_p, len(rows)), 1.0) for name, value, log_p in rows)
