"""Scheduler and workers in processes of their own, with TLS; and which connections are refused."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import UsageError
from pipeline.store import provenance
from pipeline.store.digest import table_digest
from pipeline.store.read import read_run
from pipeline.store.run import create_run
from populations.spec import DEFAULT
from tests.dask_processes import scheduler_and_worker
from tests.drawn_devices import IRREGULARITY, drawn_block, drawn_task
from tests.stub_runs import run_arguments, stub_runs
from workflows.cli import call
from workflows.screening import batch, cluster
from workflows.screening.inputs import with_own_code
from workflows.screening.scheduler import Scheduler, scheduler_of

_KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")


def openssl(folder: Path, *arguments: str) -> None:
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an authority (ca.pem), a certificate of it (own.pem, own-key.pem), and one of nobody (other.pem, ..)."""
    folder = tmp_path_factory.mktemp("certificates")
    for name in ("ca", "other"):
        openssl(
            folder, "req", "-x509", *_KEY, "-keyout", f"{name}-key.pem", "-out", f"{name}.pem", "-subj", f"/CN={name}"
        )
    openssl(folder, "req", *_KEY[:-2], "-keyout", "own-key.pem", "-out", "own.csr", "-subj", "/CN=gyroscreen")
    signed = ("-CA", "ca.pem", "-CAkey", "ca-key.pem", "-CAcreateserial", "-days", "2", "-out", "own.pem")
    openssl(folder, "x509", "-req", "-in", "own.csr", *signed)
    return folder


def options(certificates: Path, name: str = "own", ca: str = "ca") -> list[str]:
    """TLS options of gyroscreen; those of dask differ in the name of ``ca``."""
    files = {ca: "ca.pem", "cert": f"{name}.pem", "key": f"{name}-key.pem"}
    return [word for kind, file in files.items() for word in (f"--tls-{kind}", str(certificates / file))]


@pytest.fixture(scope="module")
def encrypted(certificates: Path) -> Iterator[str]:
    """Address of a scheduler with TLS, with one worker."""
    with scheduler_and_worker(options(certificates, ca="ca-file")) as (address, _):
        yield address


@pytest.mark.usefixtures("without_page")
def test_workers_behind_tls_give_the_table_of_a_local_run(encrypted, certificates, tmp_path):
    assert encrypted.startswith("tls://")
    (tmp_path / "tls").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        stub_runs(patch, drawn_block)
        assert call(run_arguments(tmp_path, devices=12)) == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch, "block_task", drawn_task)
        remote = ["--scheduler", encrypted, *options(certificates)]
        assert call([*run_arguments(tmp_path / "tls", devices=12), *remote]) == 0
    tables = [read_run(folder / "results").devices for folder in (tmp_path, tmp_path / "tls")]
    assert tables[0].num_rows == 12
    assert table_digest(tables[0]) == table_digest(tables[1])


@pytest.mark.usefixtures("without_page")
def test_workers_on_other_machines_get_the_code_of_the_user(encrypted, certificates, tmp_path, monkeypatch):
    """The copies of the driver are removed before the run, as a worker on another machine would find it."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "own.py").write_text(IRREGULARITY.format(factor=1.0), encoding="utf-8")
    own = (
        'irregularity_folders = ["mine"]\n'
        + DEFAULT.read_text(encoding="utf-8")
        + "[irregularity.own]\ndie_pct = 3.0\n"
    )
    (tmp_path / "own.toml").write_text(own, encoding="utf-8")
    arguments = run_arguments(tmp_path, devices=6, text='[source]\nspec = "own.toml"\n')
    with monkeypatch.context() as patch:
        stub_runs(patch, drawn_block)
        assert call(arguments) == 0

    def elsewhere(*given: Any) -> Any:
        config, copies, folders = with_own_code(*given)
        assert [Path(path).name for path in copies] == ["own.py"]
        for path in copies:
            shutil.rmtree(Path(path).parent)
        return config, copies, folders

    monkeypatch.setattr(batch, "with_own_code", elsewhere)
    monkeypatch.setattr(batch, "block_task", drawn_task)
    arguments[-1] = str(tmp_path / "remote")
    assert call([*arguments, "--scheduler", encrypted, *options(certificates)]) == 0
    tables = [read_run(tmp_path / name).devices for name in ("results", "remote")]
    assert table_digest(tables[0]) == table_digest(tables[1])


@pytest.mark.usefixtures("without_page")
def test_workers_with_another_gyroscreen_are_refused(encrypted, certificates, tmp_path, monkeypatch, capfd):
    ours = {**provenance.package_versions(), "numpy": "1.0"}
    for version, code in (("9.9", 2), (ours["gyroscreen"], 0)):
        monkeypatch.setattr(cluster, "package_versions", lambda v=version: {**ours, "gyroscreen": v})
        monkeypatch.setattr(batch, "block_task", drawn_task)
        remote = ["--scheduler", encrypted, *options(certificates)]
        assert call([*run_arguments(tmp_path), *remote]) == code
        message = capfd.readouterr().err
        assert ("1 of 1 workers have another gyroscreen than this machine" in message) is (code == 2)
        assert ("warning: workers have other versions of numpy;" in message) is (code == 0)


@pytest.mark.parametrize("name", ["other", None])
def test_a_client_without_a_certificate_of_the_authority_is_refused(name, encrypted, certificates, tmp_path, capfd):
    plain = encrypted.replace("tls://", "tcp://")
    who = ["--scheduler", plain] if name is None else ["--scheduler", encrypted, *options(certificates, name)]
    assert call(["run", "--devices", "1", "--out", str(tmp_path), *who]) == 2
    message = capfd.readouterr().err
    assert message.startswith("error: no connection to the dask scheduler")
    assert message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []  # an empty run would be the latest one


def test_a_run_is_still_incomplete_where_its_scheduler_does_not_answer(tmp_path, capfd):
    stopped = create_run(tmp_path, "stopped", "", {})
    assert call(["run", "--resume", "latest", "--out", str(tmp_path), "--scheduler", "tcp://127.0.0.1:9"]) == 3
    assert "resume the run again" in capfd.readouterr().err
    assert stopped.folder.exists()


@pytest.mark.parametrize(
    "address", ["tcp://10.0.0.1:8786", "10.0.0.1:8786", "tcp://0.0.0.0:1", "ws://[2001:db8::1]:8786"]
)
def test_a_plain_connection_to_another_machine_is_refused_unless_it_is_asked_for(address, tmp_path, capfd):
    assert call(["run", "--devices", "1", "--out", str(tmp_path), "--scheduler", address]) == 2
    message = capfd.readouterr().err
    assert "would not be encrypted" in message
    assert "--insecure" in message.partition("next: ")[2]
    assert list(tmp_path.iterdir()) == []
    asked = scheduler_of(address, insecure=True)
    assert asked is not None
    assert asked.security is None


def test_this_machine_needs_no_certificates_and_certificates_mean_tls(certificates):
    for address in ("tcp://127.0.0.1:8786", "tcp://[::1]:8786", "tcp://localhost:8786"):
        assert scheduler_of(address) == Scheduler(address)
    ca, own, key = (certificates / name for name in ("ca.pem", "own.pem", "own-key.pem"))
    chosen = scheduler_of("tcp://10.0.0.1:8786", ca, own, key)
    assert chosen is not None
    assert chosen.address == "tls://10.0.0.1:8786"
    assert chosen.security is not None
    assert chosen.security.require_encryption
    assert scheduler_of(None) is None


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"ca": "ca.pem"}, "--tls-ca alone"),
        ({"ca": "ca.pem", "certificate": "own.pem", "key": "other-key.pem"}, "cannot be used"),
        ({"ca": "own.csr", "certificate": "own.pem", "key": "own-key.pem"}, "cannot be used"),
        ({"ca": "ca.pem", "certificate": "none.pem", "key": "own-key.pem"}, "no such file"),
        ({}, "no certificates"),
    ],
)
def test_certificates_that_cannot_be_used_are_refused(given, words, certificates):
    with pytest.raises(UsageError, match=words):
        scheduler_of("tls://10.0.0.1:8786", **{kind: certificates / name for kind, name in given.items()})
