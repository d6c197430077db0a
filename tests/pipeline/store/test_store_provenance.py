import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pipeline.store import provenance as module
from pipeline.store.provenance import package_versions, provenance


def test_provenance_is_json_and_names_what_the_numbers_depend_on() -> None:
    facts = provenance(7, command="run")
    assert json.loads(json.dumps(facts)) == facts
    assert (facts["seed"], facts["command"]) == (7, "run")
    assert facts["versions"]["numpy"] == np.__version__
    assert {"gyroscreen", "scipy", "numba", "emcee", "pyarrow"} <= facts["versions"].keys()
    assert "pytest" not in facts["versions"]
    assert facts["simd"]


def test_without_an_installed_distribution_versions_are_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DISTRIBUTION", "no-such-distribution")
    assert package_versions() == {}


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_revision_is_that_of_the_checkout_which_tracks_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        command = ["git", "-C", str(tmp_path), *identity, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    def revision() -> tuple[str | None, bool | None]:
        facts = provenance(1)
        return facts["git_revision"], facts["git_modified"]

    installed = tmp_path / "pipeline" / "store" / "provenance.py"
    installed.parent.mkdir(parents=True)
    for path in (installed, tmp_path / "pipeline" / "__init__.py"):
        path.write_text("")
    monkeypatch.setattr(module, "__file__", str(installed))
    assert revision() == (None, None)
    git("init", "-q")
    git("commit", "-q", "--allow-empty", "-m", "somebody else's project")
    assert revision() == (None, None)
    git("add", ".")
    git("commit", "-q", "-m", "ours")
    assert revision() == (git("rev-parse", "HEAD"), False)
    installed.write_text("changed")
    assert revision() == (git("rev-parse", "HEAD"), True)
