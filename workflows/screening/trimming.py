"""Trim voltages of a device from its posterior, and its predicted values and verdict after the trim.

The prediction includes the uncertainty of the trim gains.  For a virtual device the true values after the trim are computed
too, with gains drawn for its own electrodes.

Shapes: n draws of the posterior, E pairs of trim electrodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.gyro import PHYSICAL, split_hz, to_cartesian
from pipeline.device.operation.trim import trim, trimmed_physical
from pipeline.errors import ConfigError
from pipeline.inference.estimate import RateSettings, intervals, quantities
from pipeline.inference.screening.result import DeviceResult
from pipeline.inference.systematic import common_nodes, demodulated
from reports.decision import conforms, decide
from reports.limits import Limits

from ..config_tables import TrimTable

_DRAWS = 500


def trimmed_columns(
    table: TrimTable,
    limits: Limits,
    result: DeviceResult,
    true_physical: FloatArray | None,
    rate: RateSettings,
    seed: np.random.SeedSequence,
) -> dict[str, float | str | None]:
    """The trim columns of one device; empty if it was not identified or cannot be trimmed.

    Parameters
    ----------
    table : electrodes and target.
    limits : limits and rule for the trimmed device.
    result : posterior draws; a device is trimmed only if its status is "ok".
    true_physical : true physical parameters (12,) of a virtual device, or ``None``.
    rate : settings for the rate biases.
    seed : random stream of the device's trim gains.
    """
    if result.estimate.status != "ok":
        return {}
    electrodes = table.electrodes()
    random, own = (np.random.default_rng(child) for child in seed.spawn(2))
    draws = np.stack([result.estimate.draws[name] for name in PHYSICAL], axis=1)
    kept = np.linspace(0, draws.shape[0] - 1, min(_DRAWS, draws.shape[0])).round().astype(np.int64)
    try:
        done = trim(draws[kept], electrodes, table.target(), random)
    except ConfigError:
        return {}
    # The draws contain the other common errors already.
    judged_at = rate if rate.systematic.exact else demodulated(rate, common_nodes(draws.shape[0])[kept])
    after = quantities(done.after, judged_at, split_hz(to_cartesian(done.after)))
    decision = decide(limits, {q: after[q][None] for q in limits.quantities}, ["ok"])
    summary = intervals({name: after[name] for name in ("theta_deg", "split_hz")})
    columns: dict[str, Any] = {
        "trim_voltages_v": ",".join(f"{v:.4g}" for v in done.voltages_v),
        "trim_at_limit": float(np.any(done.at_limit)),
        "trimmed_theta_deg": summary["theta_deg"],
        "trimmed_theta_deg_sd": summary["theta_deg_sd"],
        "trimmed_split_hz": summary["split_hz"],
        "trimmed_split_hz_sd": summary["split_hz_sd"],
        "trimmed_p_pass": float(decision.p_pass[0]),
        "trimmed_verdict": decision.verdict[0],
    }
    if true_physical is not None:
        gains = electrodes.draw_gains(own, 1)[0]
        true = trimmed_physical(true_physical, done.voltages_v, electrodes, gains)
        values = quantities(true[None], rate)
        columns |= {
            "trimmed_true_split_hz": float(values["split_hz"][0]),
            "trimmed_true_theta_deg": float(values["theta_deg"][0]),
            "trimmed_true_conforms": float(conforms(limits, {q: values[q] for q in limits.quantities})[0]),
        }
    return columns
