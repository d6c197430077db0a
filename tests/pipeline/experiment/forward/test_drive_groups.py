"""Records computed as one drive group equal the records computed one by one."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.drive_groups import drive_groups_of
from pipeline.experiment.forward.record import forward
from pipeline.experiment.forward.response import converted, volts
from pipeline.experiment.forward.system import assemble
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

RATE = 10_000.0
PLANT = {
    "f1_hz": 534.5,
    "f2_hz": 536.4,
    "f3_hz": 590.3,
    "zeta1": 3.2e-4,
    "zeta2": 1.6e-4,
    "zeta3": 1.2e-3,
    "theta_deg": -33.0,
    "rocking_gain": 100.0,
    "updown_gain": 60.0,
    "sense_imbalance": 0.04,
    "drive_imbalance": -0.02,
}


def _campaign() -> list[Record]:
    chirp = drive_samples(Chirp((500.0, 620.0), (620.0, 500.0), (2.0, 2.0), 0.2), RATE)
    off = np.zeros_like(chirp[:, 0])
    drives = [
        chirp,
        chirp.copy(),
        chirp[:, ::-1],
        0.35 * chirp,
        np.stack([chirp[:, 0], off], axis=1),
        np.stack([off, -chirp[:, 0]], axis=1),
        np.zeros_like(chirp),
    ]
    records = [Record(f"r{i}", RATE, np.ascontiguousarray(d), np.zeros_like(chirp)) for i, d in enumerate(drives)]
    return [*records, Record("other-bias", RATE, chirp, np.zeros_like(chirp), rate_dps=0.0, bias_v=6.0)]


@pytest.mark.parametrize("hold", ["zoh", "foh", "bandlimited"])
@pytest.mark.parametrize(
    ("effect", "p"),
    [
        (None, {}),
        ("loop_delay", {"tau": 3.3e-4}),
        ("capacitive_feedthrough", {"C_s1d1": 1e-5, "C_s2d1": -2e-5}),
        ("drive_nonlinearity", {"eps": 0.4}),
        ("cubic_stiffness", {"k3": 3e9}),
        ("adc_saturation", {"1/level": 30.0}),
    ],
)
def test_a_drive_group_gives_the_same_records_as_one_record_at_a_time(
    hold: str, effect: str | None, p: dict[str, float]
) -> None:
    model = DEFAULT_COMPARE_MODEL if effect is None else DEFAULT_COMPARE_MODEL.with_effect(effect)
    values = model.complete({**PLANT, **{f"{effect}.{name}": value for name, value in p.items()}})
    instrument = Instrument(sample_rate_hz=RATE, hold=hold, antialias=AntiAlias())  # type: ignore[arg-type]
    records = _campaign()
    groups = drive_groups_of(records, instrument, None)
    assert [len(places) for places, _ in groups] == [7, 1]
    # The up-sweep and the down-sweep: two waveforms for all drives, orders and levels.
    assert groups[0][1].gains.shape == (7, 2, 2)
    assert groups[0][1].same_drive_as[:3] == (0, 0, 2)
    for places, group in groups:
        system = assemble(model, values, instrument, group.conditions)
        together = converted(system, volts(system, group))
        for place, y in zip(places, together):
            alone = forward(model, values, records[place], instrument)
            assert np.max(np.abs(y - alone)) <= 1e-11 * max(np.max(np.abs(together)), 1e-300)
