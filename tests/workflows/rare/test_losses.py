"""gyroscreen rare: losses of the default population, configuration, output."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from pipeline.errors import ConfigError
from populations.draw import draw
from populations.spec import load_spec
from reports.limits import BoundsTable
from reports.words.preview import NOT_SAMPLED
from reports.words.rare import rare_lines, share_words
from workflows.cli import call
from workflows.config import load_config
from workflows.config_tables import SamplingTable
from workflows.rare.losses import estimated_losses, limit_states, with_sampling
from workflows.screening.plan import plan
from workflows.studies.limit_states import imbalance_loss
from workflows.studies.rare import figures, study_row

FILE = """
[limits.split_hz]
max = 6.2
[limits.sense_imbalance]
min = -0.0243
max = 0.0243
[limits.theta_deg]
min = 100
max = 270
[sampling]
limits = ["split_hz", "sense_imbalance"]
devices = 12000
"""


def config(folder: Path, text: str = FILE) -> Path:
    path = folder / "my.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_losses_of_the_population_equal_plain_monte_carlo_and_the_exact_law(tmp_path: Path) -> None:
    loaded = load_config(config(tmp_path))
    found = {one.limit: one for one in estimated_losses(loaded).losses}
    plain = with_sampling(loaded, {"method": "plain", "devices": 100_000})
    other = {one.limit: one for one in estimated_losses(plain).losses}
    for limit in ("split_hz", "total"):
        a, b = found[limit], other[limit]
        error = np.hypot(a.relative_sd * a.probability, b.relative_sd * b.probability)
        assert abs(a.probability - b.probability) < 4.0 * error
    exact = imbalance_loss("imbalance-1ppm")
    assert exact is not None
    assert exact == pytest.approx(1.07e-6, rel=0.01)
    one = found["sense_imbalance"]
    assert abs(one.probability / exact - 1.0) < 4.0 * one.relative_sd
    assert one.undecided is None


def test_seeded_devices_are_lost_as_often() -> None:
    """The devices of a run, whose lots correlate them: 40 devices of each of 60 batches of five lots."""
    ends = BoundsTable(min=524.79, max=546.21)
    loaded = msgspec.structs.replace(
        load_config(None), limits={"f1_hz": ends}, sampling=SamplingTable(method="plain", devices=20_000)
    )
    loss = estimated_losses(loaded).losses[0]
    spec, share = load_spec(), []
    for batch in range(60):
        f1 = draw(spec, 8, 1010 * batch, 40).true["f1_hz"]
        share.append(float(np.mean((f1 < 524.79) | (f1 > 546.21))))
    error = np.hypot(np.std(share) / np.sqrt(len(share)), loss.relative_sd * loss.probability)
    assert 0.03 < np.mean(share) < 0.15
    assert abs(np.mean(share) - loss.probability) < 4.0 * error


def test_the_result_depends_on_the_seed_only_and_names_what_drives_the_loss(tmp_path: Path) -> None:
    loaded = load_config(config(tmp_path))
    first, second = estimated_losses(loaded), estimated_losses(loaded)
    assert first.to_dict() == second.to_dict()
    drivers = {one.latent for one in first.drivers["sense_imbalance"]}
    assert drivers <= {f"electrode_{name}/die/[{k}]" for name in ("gap", "area") for k in (2, 3)}
    assert drivers
    text = "\n".join(rare_lines(first))
    assert "ppm" in text
    assert "any of these limits" in text


def test_the_command_prints_one_json_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(["rare", str(config(tmp_path)), "--devices", "6000", "--seed", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["limit"] for one in found["losses"]] == ["split_hz", "sense_imbalance", "total"]
    assert found["devices"] == 6000
    assert found["seed"] == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FILE.replace('"split_hz", ', '"split", '), "unknown limit"),
        (FILE.replace("12000", "1000"), "sampling.devices is too small"),
        (FILE + '[source]\nkind = "campaigns"\npath = "."\n', "a population"),
        (FILE + 'method = "guess"\n', "method"),
    ],
)
def test_what_cannot_be_sampled_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        limit_states(load_config(config(tmp_path, text)))


def test_a_plain_run_is_planned_as_before(tmp_path: Path) -> None:
    """[sampling] does not change what a run draws or stores, and a run without it does not mention it."""
    with_table = plan(load_config(config(tmp_path)))
    without = plan(load_config(config(tmp_path, FILE.split("[sampling]")[0])))
    assert with_table.blocks == without.blocks
    assert without.config.sampling is None


@pytest.mark.parametrize("sampled", [True, False])
def test_a_run_says_that_it_does_not_sample(sampled: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = FILE if sampled else FILE.split("[sampling]")[0]
    assert call(["run", str(config(tmp_path, text)), "--dry-run", "--json"]) == 0
    shown = capfd.readouterr()
    assert shown.err.splitlines() == ([NOT_SAMPLED] if sampled else [])
    assert shown.out.startswith("{")


def test_shares_in_words() -> None:
    assert share_words(1.234e-6) == "1.23 ppm"
    assert share_words(0.0123) == "1.23 %"
    assert share_words(0.0) == "0 %"


def test_the_study_counts_what_its_rows_say() -> None:
    rows = [study_row(1, ("linear-1e-6", k)) for k in range(3)]
    found = figures(rows)
    held = sum(row["low"] <= 1e-6 <= row["high"] for row in rows)
    assert str(found["linear-1e-6: interval holds"]).startswith(f"{100 * held / 3:.1f} % ({held}/3")
    assert float(found["linear-1e-6: mean estimate"].split()[0]) == pytest.approx(
        np.mean([row["probability"] for row in rows]), rel=1e-3
    )
    shifted = figures([row | {"probability": 2.0 * row["probability"]} for row in rows])
    assert float(shifted["linear-1e-6: bias over sd"].split()[0]) > 3.0
