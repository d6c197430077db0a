"""Declared look-alikes are physics: other effects of the library reproduce the same records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plants import PAPER_LIKE as PLANT

from pipeline.device.effect import LookAlike, find_effects
from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.noise.level import NoiseLevel
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.general.fit import fit_campaign
from workflows.studies.hidden.confusion import look_alike

#: Every declared look-alike at its example; one that always imitates the effect also at three times the example.
CASES = [
    pytest.param(name, like, factor, id=f"{name}-{'+'.join(like.effects)}-{factor:g}")
    for name, effect in find_effects().items()
    for like in effect.look_alikes
    for factor in ((1.0, 3.0) if like.always else (1.0,))
]
RATE, SIGMA = 10_000.0, 1e-6
NOISE = NoiseLevel(np.full(2, SIGMA), "silent", 10_000)


def test_an_answer_of_the_study_is_excused_only_where_what_it_leaves_is_below_5_sigma() -> None:
    row = {
        "kind": "left-out",
        "hidden": ["cubic_damping"],
        "refine": {"effects": ["nonlinear_damping"], "snr_left": 4.9},
    }
    assert look_alike(row)
    assert not look_alike({**row, "refine": {"effects": ["nonlinear_damping"], "snr_left": 5.1}})
    assert not look_alike({**row, "refine": {"effects": [], "snr_left": 4.9}})
    assert look_alike({**row, "kind": "bench-foreign", "refine": {"effects": [], "snr_left": 4.9}})


@pytest.mark.parametrize(("imitated", "like", "factor"), CASES)
def test_a_declared_look_alike_leaves_less_than_1e_4_of_the_chi2_of_the_baseline(
    imitated: str, like: LookAlike, factor: float
) -> None:
    # Parameters that are scanned (which channel) are no sizes.
    scanned = {parameter.name for parameter in find_effects()[imitated].parameters if parameter.grid and factor != 1.0}
    own = {name: value if name in scanned else factor * value for name, value in like.example.items()}
    values = {**PLANT, **{f"{imitated}.{name}": value for name, value in own.items()}}
    instrument = Instrument(antialias=AntiAlias())
    records = []
    for name, ends in (("up", (1.0, 1.0)), ("alone", (1.0, 0.0))):
        drive = drive_samples(Chirp(amplitude_v=ends, duration_s=1.0), RATE)
        bare = Record(name, RATE, drive, np.zeros_like(drive), "fit")
        records.append(
            replace(bare, sense_v=forward(DEFAULT_COMPARE_MODEL.with_effect(imitated), values, bare, instrument))
        )
    campaign = Campaign("device", tuple(records), instrument)
    before = fit_campaign(DEFAULT_COMPARE_MODEL, campaign, NOISE, PLANT)
    model, after = DEFAULT_COMPARE_MODEL, before
    for effect in sorted(like.effects):
        model = model.with_effect(effect)
        start = after.values | {name: value for name, value in like.start.items() if name.startswith(f"{effect}.")}
        after = fit_campaign(model, campaign, NOISE, start)
    assert after.chi2 < 1e-4 * before.chi2
