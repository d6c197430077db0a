"""gyroscreen identify, check."""

from __future__ import annotations

import json as json_
from pathlib import Path

from pipeline.device.model import load_model
from pipeline.errors import NegativeError, printable_lines
from pipeline.experiment.campaign import read_measurement
from reports.limits import load_limits
from reports.limits_origin import origin_of_file
from reports.words.limits import given_limits

from ..device.identified import identified
from ..device.measured import with_its_campaign


def identify(measurement: Path, model: Path | None, limits: Path | None, json: bool) -> None:
    """See ``gyroscreen identify --help``."""
    own = None if limits is None else load_limits(limits)
    measured = with_its_campaign(measurement)
    found = identified(measured, None if model is None else load_model(model), own)
    columns = found.to_dict()
    text = str(found)
    if limits is not None and "verdict" in columns:
        origin = origin_of_file(limits, "command line")
        columns["limits"] = origin.to_dict()
        text = f"{text}\n{given_limits(origin)}"
    print(json_.dumps(columns) if json else printable_lines(text))
    require_identified(found.status, found.columns.get("status_reason"), measurement)


def require_identified(status: str | None, reason: str | None, measurement: Path) -> None:
    """Raise NegativeError if the status of a device says that its numbers cannot be used."""
    if status not in ("fit_failed", "misfit"):
        return
    why = f" ({reason})" if reason else ""
    searched = f"gyroscreen diagnose {measurement} searches for the missing effect"
    raise NegativeError(
        f"the device has the status {status}{why}",
        allowed="ok or not_converged",
        next_step=searched if status == "misfit" else f"gyroscreen check {measurement}",
    )


def check(campaign: Path, json: bool) -> None:
    """See ``gyroscreen check --help``."""
    from ..device.checked import checked  # an identification does without

    found = checked(read_measurement(campaign))
    print(json_.dumps(found.to_dict()) if json else printable_lines(str(found)))
