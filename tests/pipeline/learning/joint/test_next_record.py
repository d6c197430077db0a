"""What another sweep or decay would show: the separation that is predicted is that of a fit to the records with the new one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.device.model import Model, PlantSpec
from pipeline.errors import UsageError
from pipeline.experiment.envelopes import EnvelopeRecord
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.tones import ToneCampaign, ToneRecord
from pipeline.inference.tones.model import ToneModel
from pipeline.learning.joint.answers import joint_answers
from pipeline.learning.joint.next_record import Repeat, repeated_record, repeats

MODEL = Model(PlantSpec("modal", 1, "displacement"))
F0, WIDTH = 1000.0, 1.0


def swept() -> ToneCampaign:
    """Two levels of a resonator with a cubic stiffness, at a declared noise."""
    random = np.random.default_rng(4)
    f = np.tile(np.linspace(F0 - 3.0, F0 + 3.0, 41), 2)
    drive = np.repeat([0.5, 1.0], 41)[:, None] + 0.0j
    blank = ToneRecord("sweep", "sweep", f, drive, np.ones((f.size, 1)) + 0.0j, role="fit")
    bent = MODEL.with_effect("cubic_stiffness")
    gain = next(name for name in MODEL.by_name if name.startswith("gain"))
    values = {name: one.null for name, one in bent.by_name.items()}
    values |= {"f1_hz": F0, "zeta1": 0.5 * WIDTH / F0, gain: 4.0 * np.pi**2 * F0 * WIDTH, "cubic_stiffness.k3": 150.0}
    values |= {"phase_deg": 20.0, "offset_s1_x": 0.0, "offset_s1_y": 0.0}
    (y,) = ToneModel(bent, ToneCampaign("r", (blank,), Instrument(1.0))).predict(values)
    sd = 1e-2 * float(np.abs(y).max())
    y = y + sd * (random.standard_normal(y.shape) + 1j * random.standard_normal(y.shape))
    return ToneCampaign("r", (replace(blank, sense_v=y, sd_v=np.full(y.shape, sd)),), Instrument(1.0))


def ringing() -> ToneCampaign:
    """The amplitude of a decay with a drag of a tenth of its damping at first, at a declared noise."""
    t, random, sd, g, h = np.linspace(0.0, 1.5, 150), np.random.default_rng(7), 5e-3, np.pi * WIDTH, 0.3
    z = g / ((g + h) * np.exp(g * t) - h)
    z = z + sd * (random.standard_normal(t.size) + 1j * random.standard_normal(t.size))
    record = EnvelopeRecord("ring", t, np.abs(z)[:, None], tuned_hz=F0, sd_v=np.full((t.size, 1), sd), role="fit")
    return ToneCampaign("r", (), Instrument(1.0), envelopes=(record,))


@pytest.mark.parametrize(
    ("measured", "effect", "scales"),
    [(swept(), "cubic_stiffness", (0.7, 1.0)), (ringing(), "nonlinear_damping", (1.0, 2.0))],
    ids=["sweep", "decay"],
)
def test_a_fit_with_the_next_record_finds_the_separation_that_was_predicted(measured, effect, scales):
    problem = joint_answers(measured, MODEL).problem
    (first,) = repeats(problem)
    found = []
    for scale in scales:
        next_one = repeated_record(problem, (), effect, first.scaled(scale))
        # A sweep has two values in each row.
        rows = 2 if isinstance(next_one.told, ToneRecord) else 1
        told = replace(next_one.told, name="next", role="fit")
        more = (
            replace(measured, records=(*measured.records, told))
            if isinstance(told, ToneRecord)
            else replace(measured, envelopes=(*measured.envelopes, told))
        )
        both = joint_answers(more, MODEL).problem
        without = both.fit(())
        fell = without.chi2 - both.fit((effect,), without).chi2
        assert np.sqrt(fell) == pytest.approx(next_one.snr, rel=0.05)
        assert next_one.apart == pytest.approx(np.sqrt(np.sum(next_one.residual**2) * rows), rel=1e-9)
        # The parameters that may follow take a part of the difference.
        assert next_one.known < next_one.snr < np.hypot(next_one.known, next_one.apart)
        found.append(next_one.snr)
    assert found[1] > found[0]


def test_a_record_that_was_not_measured_cannot_be_repeated():
    problem = joint_answers(ringing(), MODEL).problem
    with pytest.raises(UsageError, match="has this name: 'other'; allowed: ring"):
        repeated_record(problem, (), "nonlinear_damping", Repeat("other", "decay", 1.0))
