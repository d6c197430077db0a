"""What surrounds a command: the working folder, the encoding of the terminal, and paths relative to the file that names them."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.experiment.campaign import read_campaign, write_campaign
from pipeline.experiment.files.modal_record import read_modal_record
from populations.spec import DEFAULT
from tests.pipeline.experiment.checks.planted_faults import healthy
from workflows.cli import call
from workflows.config import load_config
from workflows.process import plain_text, survive_any_encoding
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.plan import plan

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("file", ["pipeline.py", "reports/__init__.py", "populations.py"])
def test_a_file_of_the_user_that_hides_a_package_is_named_in_one_line(file, tmp_path):
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("")
    code = "from workflows.learning import compare"
    search = f"import sys; sys.path[1:1] = [{str(ROOT)!r}]; "
    done = subprocess.run(
        [sys.executable, "-c", search + code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    last = done.stderr.strip().splitlines()[-1]
    hidden = Path(file).parts[0].removesuffix(".py")
    assert done.returncode == 1
    assert str(tmp_path / file) in last
    assert f"hides the package '{hidden}' of gyroscreen" in last


def test_the_command_ignores_files_of_the_working_folder(tmp_path):
    for name in ("workflows", "pipeline", "populations", "reports"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('a file of the user was imported')")
    script = Path(sys.executable).with_name("gyroscreen")
    surroundings = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [script, "--version"], cwd=tmp_path, env=surroundings, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_output_survives_a_terminal_that_is_not_utf_8(encoding, monkeypatch):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    survive_any_encoding()
    print("3 σ ± 0.1, 10⁻⁹, ψ̃, Ω, ≤, \N{SNOWMAN}", flush=True)
    assert isinstance(sys.stdout, io.TextIOWrapper)
    written = sys.stdout.buffer.getvalue().decode(encoding)  # type: ignore[attr-defined]
    assert "3 sigma" in written
    assert "10-9, psi, Omega, <=, ?" in written


def test_text_in_ascii_keeps_what_is_ascii():
    assert plain_text("theta -50.5 +- 0.1 deg") == "theta -50.5 +- 0.1 deg"


def test_paths_of_a_run_are_relative_to_its_file(tmp_path, monkeypatch):
    (tmp_path / "nights" / "lot").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "nights" / "fab.toml").write_text(DEFAULT.read_text(encoding="utf-8"), encoding="utf-8")
    write_campaign(healthy(), tmp_path / "nights" / "lot" / "one")
    monkeypatch.chdir(tmp_path / "elsewhere")
    for text in ('spec = "fab.toml"', 'kind = "campaigns"\npath = "lot"'):
        (tmp_path / "nights" / "night.toml").write_text(f"[source]\n{text}\n")
        assert call(["run", "../nights/night.toml", "--dry-run"]) == 0


def test_the_filter_and_the_converter_can_be_switched_off_everywhere(tmp_path):
    (tmp_path / "run.toml").write_text("[instrument]\nantialias = false\nadc = false\n")
    instrument = load_config(tmp_path / "run.toml").instrument.instrument()
    assert (instrument.antialias, instrument.adc) == (None, None)
    write_campaign(healthy(), tmp_path / "campaign")
    stated = tmp_path / "campaign" / "campaign.toml"
    lines = [line for line in stated.read_text().splitlines() if not line.startswith(("antialias", "adc"))]
    stated.write_text("\n".join(lines).replace("[instrument]", "[instrument]\nantialias = false\nadc = false"))
    found = read_campaign(tmp_path / "campaign").instrument
    assert (found.antialias, found.adc) == (None, None)
    modal = (ROOT / "workflows" / "configs" / "eq14.toml").read_text().splitlines()
    modal = ["antialias = false" if line.startswith("antialias") else line for line in modal]
    (tmp_path / "modal.toml").write_text("\n".join(modal))
    assert read_modal_record(tmp_path / "modal.toml").antialias is None


EFFECT = """
from pipeline.device.effect import Effect
from pipeline.device.parameters import Parameter

def force(t, q, qd, u, p, laws, out):
    for i in range(laws.axes):
        out[i] -= p[0] * qd[i] * qd[i] * qd[i]

EFFECT = Effect(
    name="own_damping", law="psi'' -= d psi'^3", source="a test", signature="peaks that grow more slowly than the drive",
    parameters=(Parameter("d", "1/V^2 s", 0.0, 1e9, "own damping", scale=1.0),), force=force, plants=("gyro",),
)
"""


def test_a_night_hides_an_effect_of_the_user_in_its_devices(tmp_path):
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws" / "own.py").write_text(EFFECT)
    path = tmp_path / "night.toml"
    path.write_text('effect_folders = ["laws"]\n[effects.own_damping]\nsize = { d = [3.0, 0.0] }\n')
    planned = plan(load_config(path))
    assert [file.what for file in planned.inputs.files] == ["effect", "population"]
    (row,) = virtual_block(planned.config, DeviceBlock(0, 0, 1)).devices.to_pylist()
    assert row["status"] == "misfit"
