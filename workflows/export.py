"""The identified model for control design: state space and the covariance of its parameters, as JSON or MAT."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from pipeline.device.gyro import PHYSICAL, gyro_mechanics, to_physical
from pipeline.device.operation.state_space import state_space
from pipeline.errors import MeasurementError, UsageError, unwritable
from pipeline.experiment.record import Campaign
from pipeline.inference.screening.result import DeviceResult

FORMATS = (".json", ".mat")


def exported(campaign: Campaign, result: DeviceResult) -> dict[str, Any]:
    """The model as plain arrays by name.

    parameters (12,) and their covariance (12, 12); A (6, 6), B (6, 2), C (2, 6), D (2, 2) continuous in time; Ad, Bd for a
    zero-order hold at sample_rate_hz; the anti-alias filter.

    Raises
    ------
    MeasurementError : the device could not be identified.
    """
    if result.fit is None:
        raise MeasurementError(
            "there is no model to export: the fit failed",
            value=result.estimate.reason,
            next_step="run gyroscreen check, then gyroscreen identify on the same campaign",
        )
    draws = np.stack([result.estimate.draws[name] for name in PHYSICAL], axis=1)
    values = to_physical(result.fit.x[None])
    ss = state_space(gyro_mechanics(values), campaign.instrument.sample_rate_hz)
    antialias = campaign.instrument.antialias
    return {
        "device_id": campaign.device_id,
        "status": result.estimate.status,
        "parameter_names": list(PHYSICAL),
        "parameters": values[0],
        "covariance": np.cov(draws.T),
        "states": ["psi_x", "psi_y", "z", "psi_x_rate", "psi_y_rate", "z_rate"],
        "A": ss.A,
        "B": ss.B,
        "C": ss.C,
        "D": ss.D,
        "Ad": ss.Ad,
        "Bd": ss.Bd,
        "sample_rate_hz": ss.sample_rate_hz,
        "antialias": None
        if antialias is None
        else {"kind": antialias.kind, "order": antialias.order, "corner_hz": antialias.corner_hz},
    }


def write_model(model: dict[str, Any], path: Path) -> None:
    """Write ``model`` as .json or .mat.

    Raises
    ------
    UsageError : another suffix, or the file cannot be written.
    """
    if path.suffix not in FORMATS:
        raise UsageError(
            "unknown format of the exported model",
            value=path.name,
            allowed=", ".join(FORMATS),
            next_step="correct the suffix of --out",
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".json":
            plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in model.items()}
            path.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
        else:
            cells = ("parameter_names", "states")
            savemat(
                path,
                {k: np.array(v, dtype=object) if k in cells else v for k, v in model.items() if v is not None},
            )
    except OSError as error:
        raise unwritable("the model", path, error, "choose another file with --out") from None
