"""First order in forces that append coordinates: equal to the whole response where they are weak, refused elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plants import PAPER_LIKE as PLANT

from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.drive_groups import DriveGroup, drive_group_of
from pipeline.experiment.forward.first_order import first_order_response, is_first_order
from pipeline.experiment.forward.record import base_of
from pipeline.experiment.forward.response import nonlinear_response
from pipeline.experiment.forward.system import System, assemble
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

RATE = 10_000.0
SUBSTEPS = 2
DRIVE = drive_samples(Chirp((500.0, 620.0), (620.0, 500.0), (2.0, 2.0), 0.3), RATE)
#: Parameters at which the second order is 1e-5 of the first or less.
WEAK = {
    "internal_resonance_1_2": {"c^2": 1e10, "delta": 0.003, "zeta": 3e-3},
    "internal_resonance_1_3": {"c^2": 1e17, "delta": -0.01, "zeta": 3e-3},
    "hysteresis": {"k": 1e-2, "r": 2e-4},
}


def _group(instrument: Instrument) -> DriveGroup:
    return drive_group_of([Record("chirp", RATE, DRIVE, np.zeros_like(DRIVE))], instrument, None)


def _system(name: str, instrument: Instrument) -> System:
    model = DEFAULT_COMPARE_MODEL.with_effect(name)
    values = {**PLANT, **{f"{name}.{key}": value for key, value in WEAK[name].items()}}
    return assemble(model, model.complete(values), instrument, _group(instrument).conditions)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("name", WEAK)
@pytest.mark.parametrize("start", [None, np.array([1e-4, -2e-4, 0.0, 0.1, 0.2, -0.3])])
def test_a_weak_force_with_coordinates_of_its_own_needs_the_first_order_only(name, hold, start) -> None:
    instrument = Instrument(antialias=AntiAlias(), hold=hold)
    group, system = _group(instrument), _system(name, instrument)
    base = base_of(DEFAULT_COMPARE_MODEL, PLANT, group, instrument, [start], SUBSTEPS)
    assert base.motions is not None
    assert is_first_order(system, base.system)
    found = first_order_response(system, group, base.motions)
    expected = nonlinear_response(system, group, [start], SUBSTEPS)
    assert np.linalg.norm(expected) > 0.0
    assert np.linalg.norm(found - expected) < 1e-5 * np.linalg.norm(expected)


def test_the_first_order_is_refused_where_more_than_forces_moves_or_senses_what_is_appended() -> None:
    instrument = Instrument(antialias=AntiAlias())
    base = base_of(DEFAULT_COMPARE_MODEL, PLANT, _group(instrument), instrument, [None], SUBSTEPS).system
    system = _system("internal_resonance_1_2", instrument)
    assert is_first_order(system, base)
    for matrix in ("stiffness", "damping", "drive", "velocity_sense"):
        coupled = getattr(system.mechanics, matrix).copy()
        coupled[0, -1 if matrix != "velocity_sense" else 0, 0 if matrix != "velocity_sense" else -1] = 1.0
        assert not is_first_order(replace(system, mechanics=replace(system.mechanics, **{matrix: coupled})), base)
    # The known coordinates move in another way.
    stiffer = system.mechanics.stiffness.copy()
    stiffer[0, 0, 0] *= 1.1
    assert not is_first_order(replace(system, mechanics=replace(system.mechanics, stiffness=stiffer)), base)
