"""The Silverbox measurement: an electronic resonator m y'' + d y' + k1 y + k3 y^3 = u, one drive, one sense.

Wigren and Schoukens, "Three free data sets for development and benchmarking in nonlinear system identification", European
Control Conference 2013.  ``SNLS80mV.mat`` holds V1 (drive) and V2 (sense, a displacement) at 610.35 Hz: a multisine to fit and
one to test, and an "arrow", noise whose level grows beyond that of the multisines.  There is no silent record and no repeat, so
the noise level is unknown and errors are given in volts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.device.model import Model, PlantSpec
from pipeline.experiment.files.columns import assemble, only
from pipeline.experiment.files.readers import existing, read_columns
from pipeline.experiment.instrument import Hold, Instrument
from pipeline.experiment.record import Campaign, Record, Role

from .. import learning
from ..learning import RefinementResult

FILE = "SNLS80mV.mat"
RATE_HZ = 610.35
#: Name, role, first sample and the one after the last.
PARTS: tuple[tuple[str, Role, int, int], ...] = (
    ("train", "fit", 40_650, 105_712),
    ("test", "validate", 105_712, 127_400),
    ("arrow", "validate", 100, 40_575),
)
#: A linear resonator, the first model of the ladder.
MODEL = Model(PlantSpec("modal", 1, "displacement"))


def campaign_of(folder: Path, hold: Hold, train_samples: int | None = None) -> Campaign:
    """The measurement as a campaign; ``train_samples`` cuts the fitted record.

    Raises
    ------
    MeasurementError : ``folder`` does not hold the file, or not its columns.
    """
    path = existing(folder / FILE)
    whole = only(assemble(path.name, [read_columns(path)], RATE_HZ, {"drive1_V": "V1", "sense1_V": "V2"}))
    records = []
    for name, role, start, stop in PARTS:
        last = stop if role != "fit" or train_samples is None else min(stop, start + train_samples)
        drive, sense = whole.drive_v[start:last].copy(), whole.sense_v[start:last].copy()
        records.append(Record(name, RATE_HZ, drive, sense, role, at_rest=False))
    return Campaign("silverbox", tuple(records), Instrument(sample_rate_hz=RATE_HZ, hold=hold, bias_v=0.0))


def refine_silverbox(folder: Path, hold: Hold, train_samples: int | None = None) -> RefinementResult:
    """Refine the linear model on the measurement."""
    return learning.refine(campaign_of(folder, hold, train_samples), MODEL)


def table(found: RefinementResult) -> list[dict[str, Any]]:
    """One row per rung: effect, status, and rms of (measured - model) in mV on every record."""
    return [
        {
            "effect": rung.effect,
            "status": rung.status,
            **{f"{name}_mv": 1e3 * volts for name, volts in (rung.error_v or {}).items()},
        }
        for rung in found.answer.ladder
    ]
