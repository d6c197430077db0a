"""A new effect is one file: the loop, the experiments, the hold check and the hidden-effects study treat it like any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_cases import USERS, example_file

from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.learning.campaign.answers import campaign_answers
from pipeline.learning.campaign.hold import hold_look_alikes
from pipeline.learning.next_experiment.experiments import experiments
from workflows.studies.hidden import study
from workflows.studies.hidden.confusion import answer, figures
from workflows.studies.hidden.draw import effects_of, hide, inseparable
from workflows.studies.hidden.effects import LIBRARY, Peak, draw_effect
from workflows.studies.hidden.own_law import without_law

FILM, LINE, CLIP = USERS, "supply_ripple", "soft_clipping"
_DECLARED = """
    depends_on_bias=True,
    mimics_hold=True,
    look_alikes=(LookAlike(("gain_drift",), {"s": 1e6}, always=True),),
)
"""
_LINE = """
import numpy as np
from pipeline.device.effect import Effect
from pipeline.device.parameters import Parameter


def disturbance(t, p, context):
    return np.stack([np.cos(2.0 * np.pi * p[0] * t), np.sin(2.0 * np.pi * p[0] * t)], axis=1)


EFFECT = Effect(
    name="supply_ripple",
    law="S += a cos(2 pi f t) + b sin(2 pi f t)",
    source="switching regulator",
    signature="one line",
    parameters=(Parameter("f", "Hz", 700.0, 900.0, "frequency", 800.0, grid=(750.0, 850.0), fitted=False),),
    disturbance=disturbance,
)
"""
_CLIP = """
import numpy as np
from pipeline.device.effect import Effect
from pipeline.device.parameters import Parameter


def adc(y, p, context):
    return np.tanh(p[0] * y) / p[0]


EFFECT = Effect(
    name="soft_clipping",
    law="y = tanh(y / level) level",
    source="input amplifier",
    signature="compressed peaks",
    parameters=(Parameter("1/level", "1/V", 0.0, 1e3, "inverse level", grid=(0.1, 0.2)),),
    adc=adc,
)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's folder with a force law, a disturbance and a converter stage that the package does not know."""
    found = tmp_path_factory.mktemp("effects")
    text = example_file().replace("import Effect, Laws", "import Effect, Laws, LookAlike")
    (found / f"{FILM}.py").write_text(text.rstrip().removesuffix(")") + _DECLARED, encoding="utf-8")
    (found / f"{LINE}.py").write_text(_LINE, encoding="utf-8")
    (found / f"{CLIP}.py").write_text(_CLIP, encoding="utf-8")
    return found


@pytest.fixture(scope="module")
def model(folder: Path) -> Model:
    return replace(DEFAULT_COMPARE_MODEL, effect_folders=(str(folder),))


def _number(model: Model, name: str) -> int:
    return model.candidates().index(name)


@pytest.mark.usefixtures("brief_records")
def test_an_effect_added_as_one_file_is_hidden_and_found(model: Model) -> None:
    hidden = hide("one", _number(model, FILM), 7, model)
    assert hidden.effects == (FILM,) == without_law(hidden.effects)
    assert 5.0 < hidden.snr[0] < 1500.0
    row = study.examine(hidden)
    assert row["failed"] == ""
    assert answer(row, "diagnose") == answer(row, "refine") == "right", row
    assert figures([row], model)["campaigns simulated by the effect's own law, not independently"] == 1

    view = campaign_answers(hidden.campaign, model, threads=1).problem
    view.fit((FILM,))
    fit = view.campaign_fit((FILM,))
    assert hold_look_alikes(fit) == (FILM,)
    assert hold_look_alikes(fit, given=(FILM,)) == ()
    offered = experiments(hidden.campaign, fit.model, fit.values, (FILM,))
    assert any(one.bias_v is not None for one in offered)


def test_the_study_hides_new_effects_in_turn_and_respects_their_look_alikes(model: Model) -> None:
    random = np.random.default_rng(1)
    names = [effects_of("one", n, random, model)[0] for n in range(len(LIBRARY) + 3)]
    assert names == list(model.candidates())
    assert {FILM, LINE, CLIP} == set(names) - set(LIBRARY)
    assert inseparable("gain_drift", FILM, model)
    pairs = [set(effects_of("two", n, random, model)) for n in range(2000)]
    assert {FILM, "gain_drift"} not in pairs
    assert any(FILM in pair for pair in pairs)


def test_sizes_that_are_not_declared_follow_from_the_parameters(model: Model) -> None:
    peak = Peak(2.0, 2.0)
    film = draw_effect(FILM, {}, peak, np.random.default_rng(0), model)
    assert film.at(1.0) == pytest.approx({f"{FILM}.s": 1e5})
    assert film.at(film.most) == pytest.approx({f"{FILM}.s": 1e12})
    assert draw_effect(CLIP, {}, peak, np.random.default_rng(0), model).direction == {f"{CLIP}.1/level": 0.5}
    assert draw_effect(LINE, {}, peak, np.random.default_rng(0), model).fixed[f"{LINE}.f"] in (750.0, 850.0)


@pytest.mark.usefixtures("short_records")
@pytest.mark.parametrize("name", [LINE, CLIP])
def test_a_new_disturbance_or_converter_stage_is_in_the_records(name: str, model: Model) -> None:
    hidden = hide("one", _number(model, name), 7, model)
    values = {n: v for n, v in hidden.values.items() if n.startswith(name)}
    assert hidden.effects == (name,)
    (driven, _) = (r.sense_v for r in hidden.campaign.records if r.name in ("chirp", "chirp-again"))
    if name == CLIP:
        level = 1.0 / values[f"{CLIP}.1/level"]
        assert np.abs(driven).max() < level + 0.02
        return
    (silent,) = hidden.campaign.with_role("noise")
    amplitude = np.abs(np.fft.rfft(silent.sense_v[:, 0] - silent.sense_v[:, 0].mean()))
    frequency = np.fft.rfftfreq(silent.sense_v.shape[0], 1e-4)[np.argmax(amplitude)]
    assert frequency == pytest.approx(values[f"{LINE}.f"], abs=10.0)
