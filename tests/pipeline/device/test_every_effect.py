"""Tests that every effect inherits, in the library or in a user's folder: null, slope, batch, pickle, passivity."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_cases import INSTRUMENT, LIBRARY, RECORD, USERS, is_scanned, values_at
from plants import PAPER_LIKE as PLANT

from pipeline.device import effects as library
from pipeline.device.effect import Context, Effect, find_effects, load_effect
from pipeline.device.exact_null import changed_stage
from pipeline.device.gyro import PHYSICAL, gyro_mechanics
from pipeline.device.mechanics import Mechanics
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model, PlantSpec
from pipeline.errors import ConfigError
from pipeline.experiment.forward.drive_groups import drive_group_of
from pipeline.experiment.forward.record import base_of, forward, signatures

CONTRACT = """
offdiagonal_damping nonlinear_damping damping_drift cubic_stiffness quadratic_stiffness electrostatic_softening
frequency_drift angular_rate updown_tilt parasitic_mode electrode_misalignment electrode_mismatch
drive_nonlinearity sense_nonlinearity capacitive_feedthrough resistive_feedthrough pickoff_crosstalk pickoff_pole
loop_delay gain_drift adc_saturation mains_hum
""".split()  # noqa: SIM905 -- as the contract lists them
LINEAR = [name for name in LIBRARY if find_effects()[name].mechanics is not None]
SLOPED = [n for n in LIBRARY if find_effects()[n].disturbance is None and not is_scanned(find_effects()[n])]


def only(names: list[str]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("effect", names, indirect=True)


def test_the_library_holds_the_contract() -> None:
    assert set(CONTRACT) <= set(LIBRARY)


def test_an_effect_has_at_most_forty_lines_and_declares_its_parameters(effect: Effect, user_folder: Path) -> None:
    folder = user_folder if effect.origin.endswith(".py") else Path(str(library.__path__[0]))
    text = (folder / f"{effect.name}.py").read_text(encoding="utf-8")
    # Docstring and imports do not count.
    assert len(text[text.index("\ndef ") :].strip().splitlines()) <= 40
    assert effect.law
    assert effect.source
    assert effect.signature
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.meaning
        assert parameter.low <= parameter.null <= parameter.high
        assert all(parameter.low <= value <= parameter.high for value in parameter.grid)


def test_at_the_null_the_record_is_bit_identical(effect: Effect, larger: Model) -> None:
    without = forward(DEFAULT_COMPARE_MODEL, PLANT, RECORD, INSTRUMENT)
    assert np.array_equal(forward(larger, PLANT, RECORD, INSTRUMENT), without)
    null = {n: v for n, v in values_at(effect, larger, 0.0).items() if not all(m.grid for m in effect.parameters)}
    assert np.array_equal(forward(larger, {**PLANT, **null}, RECORD, INSTRUMENT), without)


def test_each_stage_is_exactly_absent_at_the_null(effect: Effect) -> None:
    assert changed_stage(effect) == ""


@pytest.mark.parametrize(
    ("law", "declared", "stage"),
    [
        ("force=lambda t, q, qd, u, p, laws, out: _add(out, (1.0 + p[0]) * q[0])", "", "force"),
        ("sense=lambda x, xd, s, t, p, context: s + 1e-6 + p[0]", "", "sense"),
        ("readout=lambda readout, p, context: readout.through(np.eye(2) * (1.0 + 1e-9 + p[0]))", "", "readout"),
        ("drive=lambda v, p, context: v * p[0]", "", "drive"),
        ("drive=lambda v, p, context: v * p[0]", ", null=1.0", ""),
    ],
)
def test_an_effect_whose_null_is_not_exactly_absent_is_refused(
    law: str, declared: str, stage: str, tmp_path: Path
) -> None:
    (tmp_path / "offset.py").write_text(
        "import numpy as np\nfrom pipeline.device.effect import Effect\nfrom pipeline.device.parameters import Parameter\n"
        "import numba\n@numba.njit\ndef _add(out, value):\n    out[0] += value\n"
        f"P = Parameter('a', '1', 0.0, 9.0, 'size'{declared})\n"
        f"EFFECT = Effect(name='offset', law='l', source='s', signature='s', parameters=(P,), {law})\n",
        encoding="utf-8",
    )
    model = replace(DEFAULT_COMPARE_MODEL, effect_folders=(str(tmp_path),))
    if not stage:
        assert "offset" in model.with_effect("offset").effects
        return
    with pytest.raises(ConfigError, match=f"not exactly no effect: its stage '{stage}'"):
        model.with_effect("offset")


@only([*SLOPED, USERS])
def test_the_signature_is_the_derivative_of_the_record_at_the_null(effect: Effect, larger: Model) -> None:
    share = 1e-3
    at = values_at(effect, larger, share)
    grid = {m.name: (at[effect.full_name(m)],) for m in effect.members(larger.built.shape) if m.grid}
    smaller = larger.without_effect(effect.name)
    group = drive_group_of([RECORD], INSTRUMENT, None)
    (found,) = signatures(base_of(smaller, PLANT, group, INSTRUMENT), effect.name, grid=grid)
    steps = {m.name: at[effect.full_name(m)] - m.null for m in effect.members(larger.built.shape) if not m.grid}
    expected = np.tensordot([steps[name] for name in found.names], found.columns[:, 0], axes=1)
    change = forward(larger, {**PLANT, **at}, RECORD, INSTRUMENT) - forward(smaller, PLANT, RECORD, INSTRUMENT)
    assert np.linalg.norm(expected) > 0.0
    assert np.linalg.norm(change - expected) < 2e-2 * np.linalg.norm(expected)


def test_the_effect_changes_the_record(effect: Effect, larger: Model) -> None:
    if effect.disturbance is not None:
        t = np.arange(1000) / 10_000.0
        p = np.array([m.grid[-1] if m.grid else m.null + m.scale for m in effect.members(larger.built.shape)])
        energy = np.linalg.norm(effect.disturbance(t, p, Context(5.0, 5.0, {})), axis=0) ** 2
        assert np.all(energy > 0.0)
        # Sines and cosines have a mean square of one half.
        assert not effect.mains_frequency or np.allclose(energy, 500.0, rtol=0.05)
        return
    values = values_at(effect, larger, 1.0)
    if effect.adc is not None:
        values = dict.fromkeys(values, 20.0)
    y0 = forward(larger, PLANT, RECORD, INSTRUMENT)
    change = forward(larger, {**PLANT, **values}, RECORD, INSTRUMENT) - y0
    assert np.linalg.norm(change) > 1e-7 * np.linalg.norm(y0)


def test_pickle_and_repr_are_lossless(effect: Effect, larger: Model) -> None:
    assert pickle.loads(pickle.dumps(effect)) == effect
    assert eval(repr(effect), {"load_effect": load_effect}) == effect
    again = pickle.loads(pickle.dumps(larger))
    assert again == larger
    assert again.free == larger.free
    assert eval(repr(larger), {"Model": Model, "PlantSpec": PlantSpec}) == larger


def _batch() -> tuple[Mechanics, dict[str, np.ndarray]]:
    one = np.array([PLANT.get(name, 0.0) for name in PHYSICAL])
    many = one * np.array([[1.0], [1.01], [0.98]])
    return gyro_mechanics(many), dict(zip(PHYSICAL, many.T))


@only(LINEAR)
def test_a_batch_gives_the_same_mechanics_as_single_devices(effect: Effect) -> None:
    p = np.array([m.grid[0] if m.grid else m.null + m.scale for m in effect.members(DEFAULT_COMPARE_MODEL.built.shape)])
    batch, named = _batch()
    whole = effect.mechanics(batch, p, Context(5.0, 5.0, named))
    fields = ("damping", "gyroscopic", "stiffness", "drive", "velocity_sense", "position_sense")
    for i in range(3):
        one = Mechanics(**{f: getattr(batch, f)[i : i + 1] for f in fields})
        alone = effect.mechanics(one, p, Context(5.0, 5.0, {k: v[i] for k, v in named.items()}))
        for f in fields:
            assert np.array_equal(getattr(whole, f)[i], getattr(alone, f)[0])


@only(LINEAR)
def test_damping_and_stiffness_stay_symmetric_and_positive(effect: Effect) -> None:
    p = np.array(
        [m.grid[0] if m.grid else m.null + 0.1 * m.scale for m in effect.members(DEFAULT_COMPARE_MODEL.built.shape)]
    )
    batch, named = _batch()
    changed = effect.mechanics(batch, p, Context(5.0, 5.0, named))
    for matrix in (changed.damping, changed.stiffness):
        assert np.array_equal(matrix, np.swapaxes(matrix, 1, 2))
        assert np.all(np.linalg.eigvalsh(matrix) > 0.0)
    assert np.array_equal(changed.gyroscopic, -np.swapaxes(changed.gyroscopic, 1, 2))


def test_a_wrong_effect_file_is_a_config_error(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("EFFECT = 1 / 0\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="fails when it is run"):
        find_effects((tmp_path,))
    (tmp_path / "broken.py").write_text("x = 1\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="no EFFECT"):
        find_effects((tmp_path,))
    with pytest.raises(ConfigError, match="folder of effects does not exist"):
        find_effects((tmp_path / "absent",))


def test_two_effects_with_the_same_name_are_refused(user_folder: Path, tmp_path: Path) -> None:
    text = (user_folder / f"{USERS}.py").read_text(encoding="utf-8")
    (tmp_path / "mine.py").write_text(text.replace('"squeeze_film"', '"gain_drift"'), encoding="utf-8")
    with pytest.raises(ConfigError, match="two effects with the same name"):
        find_effects((tmp_path,))


def test_a_force_that_does_not_compile_is_a_config_error(tmp_path: Path, user_folder: Path) -> None:
    text = (user_folder / f"{USERS}.py").read_text(encoding="utf-8")
    body = text.replace("for i in range(laws.axes):", "import pathlib\n    for i in range(laws.axes):", 1)
    (tmp_path / "bad.py").write_text(body.replace("squeeze_film", "bad"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"does not compile, .*bad.py, line 8: .*pathlib"):
        replace(DEFAULT_COMPARE_MODEL, effect_folders=(str(tmp_path),)).with_effect("bad")
