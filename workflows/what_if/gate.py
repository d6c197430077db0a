"""The status of stored devices by the gate of other limits.

The gate refuses a device whose bias by an undetected effect may exceed a share of the width of a limit, so its verdict depends on
the limits.  Everything else that decides on the status is stored and stays.

Shapes: B devices.
"""

from __future__ import annotations

import numpy as np

from pipeline.arrays import BoolArray
from pipeline.inference.gate import Gate
from reports.coded import CodedText
from reports.devices import Devices
from reports.limits import Limits

from ..config import RunConfig


def status_by(devices: Devices, config: RunConfig, old: Limits, new: Limits) -> CodedText:
    """B statuses by the gate for ``new``, from the statuses by the gate for ``old``.

    A misfit is accepted only where its bias bound was the reason: the old gate refuses the bound, and nothing else refuses the
    device.  fit_failed and lost devices stay what they are.
    """
    before = devices.text("status")
    refused_before, refused_now = (_refused(devices, config.gate.gate(limits)) for limits in (old, new))
    gate = config.gate.gate(new)
    alone = refused_before & ~_otherwise_refused(devices, gate)
    settings = config.posterior
    rhat, ess = devices.number("rhat"), devices.number("ess")
    converged = (rhat <= settings.rhat_max) & (ess >= settings.ess_min)
    freed = before.equals("misfit") & alone & ~refused_now
    caught = (before.equals("ok") | before.equals("not_converged")) & refused_now
    words = tuple(dict.fromkeys((*before.words, "ok", "not_converged", "misfit")))
    codes = np.array([words.index(word) for word in before.words], dtype=np.int64)[before.codes]
    codes = np.where(freed, np.where(converged, words.index("ok"), words.index("not_converged")), codes)
    return CodedText(words, np.where(caught, words.index("misfit"), codes))


def _refused(devices: Devices, gate: Gate) -> BoolArray:
    """(B,) whether an undetected effect could bias a quantity by more than the gate allows; a null bound refuses nothing."""
    refused = np.zeros(len(devices), dtype=np.bool_)
    for quantity, most in {"theta_deg": gate.theta_bias_max_deg, **gate.bias_max}.items():
        refused |= devices.number(f"{quantity}_bias_bound") > most
    return refused


def _otherwise_refused(devices: Devices, gate: Gate) -> BoolArray:
    """(B,) whether the error, a significant effect or the excess of chi2 refuses the device, whatever the limits."""
    error = devices.number("error_all_noise")
    error = np.where(np.isnan(error), devices.number("error"), error)
    return np.asarray(
        ~(error <= gate.error_max)
        | (devices.number("effect_p_value") <= gate.alpha)
        | (devices.number("theta_bias_bound_deg") > gate.theta_bias_max_deg)
    )
