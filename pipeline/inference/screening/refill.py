"""Bad samples in the in-band likelihood, which needs whole records: they are replaced by their expectation under the model.

    y_bad <- E(y_bad | good samples, x) = model(x) + interpolated residual,        x <- argmax L(y, x),        and so on

is the EM algorithm (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39 (1977) 1).  With a share m of the information in the bad
samples, the distance from its limit falls by the factor m in each round, so 2 % need three rounds.

Shapes: x (P,) parameters; records (N, 2) [V]; sigma (2,) [V].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ...experiment.bad_samples import refilled
from ...experiment.record import Record
from .compressed import BandData
from .fit import Fit, maximise
from .mismatch import MismatchPrior

#: Rounds; a share of 2 % of the samples may hold a fifth of the information where it lies in a resonance: 0.2^6 = 6e-5.
_ROUNDS = 6
#: Change of x [sd] that ends the rounds: with it, the intervals are off by a fiftieth of their half-width at most.
_UNCHANGED = 0.02


def refilled_fit(
    fit: Fit,
    records: Sequence[Record],
    data: Sequence[BandData],
    sigma_v: FloatArray,
    model_v: Callable[[FloatArray, FloatArray], FloatArray],
    prior: MismatchPrior | None = None,
) -> tuple[Fit, list[Record], list[BandData]]:
    """The fit to the good samples of ``records``; records and data with their bad samples as the model expects them.

    Parameters
    ----------
    fit : to records whose bad samples are interpolated.
    records, data : the fit records, and the same in the band.
    sigma_v : noise (2,) [V].
    model_v : (x (P,), drive (N, 2) [V]) -> pick-off volts (N, 2) [V].
    prior : of the mismatches, P = 14; ``None``: they are no parameters, P = 12.
    """
    own, band = list(records), list(data)
    for _ in range(_ROUNDS):
        for i, record in enumerate(own):
            if record.good is not None:
                own[i] = refilled(record, model_v(fit.x, record.drive_v))
                band[i] = replace(band[i], spectrum=band[i].band.transform(own[i].sense_v))
        moved = maximise(band, sigma_v, fit.x, prior)
        change = np.abs(moved.x - fit.x) / np.sqrt(np.diagonal(moved.covariance))
        fit = moved
        if not fit.converged or np.max(change) < _UNCHANGED:
            break
    return fit, own, band
