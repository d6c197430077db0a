"""The learning loop on campaigns: no effect is named where none is hidden, hidden ones are named, and the error falls."""

import json

import pytest

from pipeline.experiment.campaign import write_campaign
from workflows.cli import call
from workflows.learning import diagnose, refine
from workflows.simulate import campaign_config, simulate

pytestmark = pytest.mark.usefixtures("brief_records")

USER_EFFECT = '''
"""Springs that soften with the fourth power of the motion."""
from pipeline.device.effect import Effect
from pipeline.device.parameters import Parameter

def force(t, q, qd, u, p, laws, out):
    square = 0.0
    for i in range(laws.axes):
        square += q[i] * q[i]
    for i in range(laws.axes):
        out[i] -= p[0] * square * square * q[i]

EFFECT = Effect(
    name="quintic_stiffness",
    law="psi'' -= k5 |psi|^4 psi",
    source="a user",
    signature="as cubic, but growing as the fourth power of the level",
    parameters=(Parameter("k5", "1/(V^4 s^6)", -1e24, 1e24, "quintic stiffness", scale=1e16),),
    force=force,
    plants=("gyro",),
)
'''


def test_no_effect_is_named_where_none_is_hidden():
    found = diagnose(simulate(campaign_config(None), {}, [], 4).campaign)
    assert (found.verdict, found.effects) == ("adequate", ())


def test_the_ladder_adds_the_hidden_effect_reaches_the_noise_and_recovers_theta():
    made = simulate(campaign_config(None), {}, ["offdiagonal_damping:c12=0.4"], 5)
    found = refine(made.campaign)
    assert (found.verdict, found.effects) == ("adequate", ("offdiagonal_damping",))
    answer = found.answer
    assert answer.ladder[-1].status == "confirmed"
    assert answer.ladder[0].error_validate > 1.05 > 1.02 > answer.ladder[-1].error_validate
    theta, sd = answer.theta_deg
    assert abs(theta - made.parameters["theta_deg"]) < 4.0 * sd
    c12, sd = answer.parameters["c12_per_s"]
    assert abs(c12 - 0.4) < 4.0 * sd


def test_effects_that_the_records_cannot_separate_are_a_class():
    found = diagnose(simulate(campaign_config(None), {}, ["loop_delay"], 3).campaign)
    assert found.verdict == "class"
    assert set(found.classes[0]) == {"loop_delay", "pickoff_pole"}


def test_a_users_own_effect_goes_through_the_same_commands(tmp_path, capfd):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "quintic_stiffness.py").write_text(USER_EFFECT)
    made = simulate(campaign_config(None), {}, ["quintic_stiffness"], 6, [str(folder)])
    write_campaign(made.campaign, tmp_path / "campaign")
    arguments = [str(tmp_path / "campaign"), "--effects", str(folder), "--out", str(tmp_path / "page"), "--json"]
    assert call(["diagnose", *arguments]) == 0
    answer = json.loads(capfd.readouterr().out)
    assert "quintic_stiffness" in answer["effects"] or any("quintic_stiffness" in c for c in answer["classes"])
    assert answer["candidates"][0]["p_value"] < 1e-6
    assert (tmp_path / "page" / "diagnose.html").read_text().lower().startswith("<!doctype html>")


@pytest.mark.parametrize("command", ["compare", "diagnose", "refine"])
def test_a_missing_campaign_gives_one_error_message(command, tmp_path, capfd):
    assert call([command, str(tmp_path / "none")]) == 5
    assert capfd.readouterr().err.startswith("error: ")
