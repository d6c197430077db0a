"""What every effect inherits, the library's and a user's alike."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import PAPER_LIKE as PLANT

from pipeline.device import effects as library
from pipeline.device.effect import Context, Effect, find_effects, load_effect
from pipeline.device.gyro import PHYSICAL, gyro_mechanics
from pipeline.device.mechanics import Mechanics
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model, PlantSpec
from pipeline.errors import ConfigError
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.drive_groups import drive_group_of
from pipeline.experiment.forward.integrate import trajectory
from pipeline.experiment.forward.record import base_of, forward, signatures
from pipeline.experiment.forward.system import assemble, conditions_of
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

ROOT = Path(__file__).resolve().parents[3]
CONTRACT = """
offdiagonal_damping nonlinear_damping damping_drift cubic_stiffness quadratic_stiffness electrostatic_softening
frequency_drift angular_rate updown_tilt parasitic_mode electrode_misalignment electrode_mismatch
drive_nonlinearity sense_nonlinearity capacitive_feedthrough resistive_feedthrough pickoff_crosstalk pickoff_pole
loop_delay gain_drift adc_saturation mains_hum
""".split()  # noqa: SIM905 -- as the contract lists them
LINEAR = [name for name in CONTRACT if find_effects()[name].mechanics is not None]
SLOPED = [n for n in CONTRACT if find_effects()[n].disturbance is None and find_effects()[n].adc is None]
INSTRUMENT = Instrument(antialias=AntiAlias())
_DRIVE = drive_samples(Chirp((500.0, 620.0), (620.0, 500.0), (2.0, 2.0), 0.1), 10_000.0)
RECORD = Record("chirp", 10_000.0, _DRIVE, np.zeros_like(_DRIVE))


@pytest.fixture(scope="module")
def user_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the effect that the how-to shows."""
    text = (ROOT / "docs" / "add-an-effect.md").read_text(encoding="utf-8")
    block = re.search(r"```python\n(.*?)```", text, re.S)
    assert block is not None
    folder = tmp_path_factory.mktemp("my-effects")
    (folder / "squeeze_film.py").write_text(block[1], encoding="utf-8")
    return folder


@pytest.fixture(params=[*CONTRACT, "squeeze_film"])
def effect(request: pytest.FixtureRequest, user_folder: Path) -> Effect:
    return find_effects((user_folder,))[request.param]


def only(names: list[str]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("effect", names, indirect=True)


@pytest.fixture
def larger(effect: Effect, user_folder: Path) -> Model:
    return replace(DEFAULT_COMPARE_MODEL, effect_folders=(str(user_folder),)).with_effect(effect.name)


def _values(effect: Effect, larger: Model, share: float) -> dict[str, float]:
    """Parameters at ``share`` of their scale; those of a grid at its middle."""
    shape = larger.built.shape
    return {
        effect.full_name(m): m.grid[len(m.grid) // 2] if m.grid else m.null + share * m.scale
        for m in effect.members(shape)
    }


def test_the_library_is_the_contract() -> None:
    assert set(find_effects()) == set(CONTRACT)


def test_it_declares_itself_in_at_most_forty_lines(effect: Effect, user_folder: Path) -> None:
    folder = user_folder if effect.origin.endswith(".py") else Path(str(library.__path__[0]))
    text = (folder / f"{effect.name}.py").read_text(encoding="utf-8")
    # The head (docstring, imports) of a library file is the house's style, not the author's work.
    assert len(text[text.index("\ndef ") :].strip().splitlines()) <= 40
    assert effect.law
    assert effect.source
    assert effect.signature
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.meaning
        assert parameter.low <= parameter.null <= parameter.high
        assert all(parameter.low <= value <= parameter.high for value in parameter.grid)


def test_null_is_no_effect_bit_by_bit(effect: Effect, larger: Model) -> None:
    without = forward(DEFAULT_COMPARE_MODEL, PLANT, RECORD, INSTRUMENT)
    assert np.array_equal(forward(larger, PLANT, RECORD, INSTRUMENT), without)
    null = {n: v for n, v in _values(effect, larger, 0.0).items() if not all(m.grid for m in effect.parameters)}
    assert np.array_equal(forward(larger, {**PLANT, **null}, RECORD, INSTRUMENT), without)


@only([*SLOPED, "squeeze_film"])
def test_it_grows_smoothly_from_the_null_with_its_signature_as_slope(effect: Effect, larger: Model) -> None:
    share = 1e-3
    at = _values(effect, larger, share)
    grid = {m.name: (at[effect.full_name(m)],) for m in effect.members(larger.built.shape) if m.grid}
    smaller = larger.without_effect(effect.name)
    group = drive_group_of([RECORD], INSTRUMENT, None)
    (found,) = signatures(base_of(smaller, PLANT, group, INSTRUMENT), effect.name, grid=grid)
    steps = {m.name: at[effect.full_name(m)] - m.null for m in effect.members(larger.built.shape) if not m.grid}
    expected = np.tensordot([steps[name] for name in found.names], found.columns[:, 0], axes=1)
    change = forward(larger, {**PLANT, **at}, RECORD, INSTRUMENT) - forward(smaller, PLANT, RECORD, INSTRUMENT)
    assert np.linalg.norm(expected) > 0.0
    assert np.linalg.norm(change - expected) < 2e-2 * np.linalg.norm(expected)


def test_an_observable_moves(effect: Effect, larger: Model) -> None:
    if effect.disturbance is not None:
        t = np.arange(1000) / 10_000.0
        basis = effect.disturbance(t, np.array([60.0, 16.0]), Context(5.0, 5.0, {}))
        assert np.allclose(np.linalg.norm(basis, axis=0) ** 2, 500.0, rtol=0.05)
        return
    values = _values(effect, larger, 1.0)
    if effect.adc is not None:
        values = dict.fromkeys(values, 20.0)
    y0 = forward(larger, PLANT, RECORD, INSTRUMENT)
    change = forward(larger, {**PLANT, **values}, RECORD, INSTRUMENT) - y0
    assert np.linalg.norm(change) > 1e-7 * np.linalg.norm(y0)


def test_pickle_and_repr_give_it_back(effect: Effect, larger: Model) -> None:
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
def test_a_batch_is_a_loop(effect: Effect) -> None:
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
def test_it_leaves_damping_and_stiffness_symmetric_and_passive(effect: Effect) -> None:
    p = np.array(
        [m.grid[0] if m.grid else m.null + 0.1 * m.scale for m in effect.members(DEFAULT_COMPARE_MODEL.built.shape)]
    )
    batch, named = _batch()
    changed = effect.mechanics(batch, p, Context(5.0, 5.0, named))
    for matrix in (changed.damping, changed.stiffness):
        assert np.array_equal(matrix, np.swapaxes(matrix, 1, 2))
        assert np.all(np.linalg.eigvalsh(matrix) > 0.0)
    assert np.array_equal(changed.gyroscopic, -np.swapaxes(changed.gyroscopic, 1, 2))


@pytest.mark.parametrize("name", ["nonlinear_damping", "cubic_stiffness", "quadratic_stiffness"])
@settings(max_examples=15, deadline=None)
@given(angle=st.floats(0.0, 6.28), share=st.floats(0.1, 50.0))
def test_energy_falls_without_drive(name: str, angle: float, share: float) -> None:
    model = DEFAULT_COMPARE_MODEL.with_effect(name)
    found = model.effect(name)
    values = model.complete({**PLANT, **_values(found, model, share)})
    system = assemble(model, values, INSTRUMENT, conditions_of(RECORD, INSTRUMENT, None))
    start = np.array([3e-4 * np.cos(angle), 3e-4 * np.sin(angle), 1e-4, 0.0, 0.0, 0.0])
    forces = [(e.force, p) for e, p in system.forces]
    linear, deviation = trajectory(system.mechanics, forces, system.laws, np.zeros((300, 2)), 1e-4, "zoh", start)
    q, qd = np.hsplit(linear + deviation, 2)
    potential = 0.5 * np.einsum("mi,ij,mj->m", q, system.mechanics.stiffness[0], q)
    p = system.forces[0][1]
    if name == "cubic_stiffness":
        potential = potential + p[0] / 4.0 * np.sum(q[:, :2] ** 2, axis=1) ** 2
    if name == "quadratic_stiffness":
        potential = potential + np.sum(p * q[:, :2] ** 3, axis=1) / 3.0
    energy = potential + 0.5 * np.sum(qd**2, axis=1)
    assert np.all(np.diff(energy) < 1e-9 * energy[0])
    assert energy[-1] < energy[0]


def test_a_wrong_file_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("EFFECT = 1 / 0\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="fails when it is run"):
        find_effects((tmp_path,))
    (tmp_path / "broken.py").write_text("x = 1\n", encoding="utf-8")
    load_effect.cache_clear()
    with pytest.raises(ConfigError, match="no EFFECT"):
        find_effects((tmp_path,))
    with pytest.raises(ConfigError, match="folder of effects does not exist"):
        find_effects((tmp_path / "absent",))


def test_a_name_can_be_taken_only_once(user_folder: Path, tmp_path: Path) -> None:
    text = (user_folder / "squeeze_film.py").read_text(encoding="utf-8")
    (tmp_path / "mine.py").write_text(text.replace('"squeeze_film"', '"gain_drift"'), encoding="utf-8")
    with pytest.raises(ConfigError, match="two effects with the same name"):
        find_effects((tmp_path,))


def test_a_force_that_cannot_be_compiled_says_so(tmp_path: Path, user_folder: Path) -> None:
    text = (user_folder / "squeeze_film.py").read_text(encoding="utf-8")
    body = text.replace("for i in range(laws.axes):", "print(open('x')); import os\n    for i in range(laws.axes):", 1)
    (tmp_path / "bad.py").write_text(body.replace("squeeze_film", "bad"), encoding="utf-8")
    model = replace(DEFAULT_COMPARE_MODEL, effect_folders=(str(tmp_path),)).with_effect("bad")
    with pytest.raises(ConfigError, match="does not compile"):
        forward(model, {**PLANT, "bad.s": 1.0}, RECORD, INSTRUMENT)
