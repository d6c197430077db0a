"""The README is correct: its commands run, and its links lead to existing files."""

import re
import shlex
from pathlib import Path

import pytest

from workflows.cli import call
from workflows.simulate import campaign_config, simulate

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
#: Run elsewhere in the suite, or in need of another machine; their options are still parsed by --help below.
SLOW = ("run", "compare", "diagnose", "refine", "paper")


def lines():
    blocks = re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)
    for line in "\n".join(blocks).splitlines():
        if line.startswith("gyroscreen "):
            yield shlex.split(line.split("#")[0])[1:]


def test_the_run_and_test_commands_create_a_virtual_environment():
    run, test = re.findall(r"<!-- (?:run|test) command -->\n```sh\n(.*?)\n```", README)
    assert run.startswith("python3 -m venv .venv && .venv/bin/pip install")
    assert run.endswith(".venv/bin/gyroscreen run")
    assert test.startswith("python3 -m venv .venv && .venv/bin/pip install")
    assert test.endswith(".venv/bin/pytest -n 2")


def test_links_of_the_readme_lead_to_existing_files():
    for target in re.findall(r"\]\(([^)]+)\)", README):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("arguments", list(lines()), ids=" ".join)
def test_every_option_shown_is_in_the_help_of_its_command(arguments, capfd):
    options = [a for a in arguments if a.startswith("--")]
    group = arguments[:2] if arguments[0] == "model" else arguments[:1]
    assert call([*group, "--help"]) == 0
    help_text = capfd.readouterr().out
    for option in options:
        assert option in help_text


@pytest.mark.usefixtures("brief_records")
def test_the_shown_commands_on_a_campaign_work(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for arguments in lines():
        if arguments[0] in ("simulate", "check", "identify", "model") and "--stream" not in arguments:
            # The campaign has an effect that the model of identify lacks: a misfit.
            assert call(arguments) == (1 if arguments[0] == "identify" else 0), arguments
    assert (tmp_path / "campaign" / "campaign.toml").exists()
    assert (tmp_path / "device.json").exists()


@pytest.mark.usefixtures("brief_records")
def test_the_python_example_of_the_readme_runs(tmp_path, monkeypatch, capfd):
    from pipeline.experiment.campaign import write_campaign

    code = re.search(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert code is not None
    monkeypatch.chdir(tmp_path)
    write_campaign(simulate(campaign_config(None), {}, [], 8).campaign, tmp_path / "campaign")
    exec(compile(code[1], "README.md", "exec"), {})
    assert "fit" in capfd.readouterr().out
