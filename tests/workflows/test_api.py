"""The interface for notebooks: it loads at once, every name is documented, and its faults are typed errors."""

import inspect
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

from pipeline.errors import ConfigError, GyroscreenError, MeasurementError, UsageError
from pipeline.experiment.envelopes import EnvelopeRecord
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.tones import ToneCampaign, ToneRecord
from pipeline.store.run import create_run
from pipeline.store.schema import devices_table
from tests.pipeline.experiment.checks.planted_faults import healthy
from workflows import api as gs

#: Packages that take most of the time of an import.
HEAVY = {"numpy", "scipy", "pandas", "numba", "matplotlib", "pyarrow", "dask", "duckdb"}


def test_the_import_loads_nothing_that_takes_time():
    code = "import sys; from workflows import api; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not HEAVY & set(done.stdout.split())


def test_every_name_is_found_listed_and_documented():
    assert dir(gs) == sorted(gs.__all__)
    for name in gs.__all__:
        found = getattr(gs, name)
        text = inspect.getdoc(found) or ""
        assert len(text) > 30, name
        assert f"{name}" in (gs.__doc__ or "") or name == "ScreeningRun"
    with pytest.raises(AttributeError, match="nothing_such"):
        _ = gs.nothing_such


CALLS = (
    "check",
    "compare",
    "compare_lot",
    "diagnose",
    "diagnose_lot",
    "identify",
    "inference_data",
    "open_run",
    "read_campaign",
    "read_lot",
    "refine",
    "refine_lot",
    "run",
    "simulate",
    "simulate_lot",
)


@pytest.mark.parametrize("name", CALLS)
def test_calls_have_types_and_an_example(name):
    call = getattr(gs, name)
    parameters = inspect.signature(call).parameters.values()
    assert all(one.annotation is not inspect.Parameter.empty for one in parameters)
    assert inspect.signature(call).return_annotation is not inspect.Signature.empty
    assert ">>> " in call.__doc__


def test_every_figure_is_documented():
    for name, figure in inspect.getmembers(gs.figures, inspect.isfunction):
        if not name.startswith("_") and figure.__module__ == gs.figures.__name__:
            assert figure.__doc__, name
            assert figure.__annotations__["return"], name


@pytest.fixture
def stored(tmp_path):
    """A run of two devices without draws."""
    store = create_run(tmp_path / "results", "night", "", {"seed": 1})
    columns = {"device_id": ["a", "b"], "split_hz": [1.0, float("nan")], "status": ["ok", "misfit"]}
    store.commit_block(0, devices_table(columns | {"verdict": ["pass", "undecided"]}), None)
    store.finish("complete", {})
    return tmp_path / "results"


def test_a_run_without_draws_lots_or_places_is_read(stored):
    night = gs.open_run(results=stored)
    assert night.run_id == gs.open_run(str(stored / "run=night")).run_id == gs.open_run("night", stored).run_id
    assert night.devices["split_hz"].tolist()[0] == 1.0
    assert list(night.devices.columns) == ["split_hz", "verdict", "status"]
    assert night.posterior.empty
    assert night.yields["yield"].tolist() == [0.5]
    assert "2 devices, yield 50" in str(night)


def test_wrong_arguments_give_typed_errors(stored, tmp_path):
    night = gs.open_run(results=stored)
    cases = {
        UsageError: (
            lambda: gs.open_run("other", stored),
            lambda: gs.open_run(results=tmp_path / "none"),
            lambda: night.inference_data("c"),
            lambda: night.inference_data("a"),
            lambda: gs.figures.corner(night, "a"),
            lambda: gs.figures.wafer_maps(night),
            lambda: night.query("DELETE FROM devices"),
            lambda: night.report("/proc/none/page.html"),
            lambda: gs.run(workers=-1),
            lambda: gs.identify(healthy(), limits=None) and gs.inference_data(gs.identify(healthy()), "a"),
        ),
        ConfigError: (
            lambda: gs.run(tmp_path / "none.toml"),
            lambda: gs.run(devices=0, out=tmp_path),
            lambda: gs.load_limits({"limits": {"splt_hz": {"max": 3.0}}}),
            lambda: gs.load_model(tmp_path / "none.toml"),
            lambda: gs.simulate({"split": 1.0}),
            lambda: gs.simulate(effects=["no_such_effect"]),
            lambda: gs.compare(healthy(), effect_folders=[tmp_path / "none"]),
        ),
        MeasurementError: (lambda: gs.read_campaign(tmp_path / "none"), lambda: gs.refine(tmp_path / "none")),
    }
    for kind, calls in cases.items():
        for call in calls:
            with pytest.raises(kind) as caught:
                call()
            assert isinstance(caught.value, GyroscreenError)
            assert caught.value.next_step or caught.value.allowed, caught.value


def test_arviz_that_is_missing_is_named_with_its_extra(monkeypatch):
    found = gs.identify(healthy())
    monkeypatch.setitem(sys.modules, "arviz_base", None)
    with pytest.raises(ConfigError, match=r"gyroscreen\[arviz\]"):
        gs.inference_data(found)


def test_identify_judges_by_limits_of_a_table_and_of_a_file(tmp_path):
    table = {"limits": {"split_hz": {"max": 1e-3}}}
    (tmp_path / "limits.toml").write_text("[limits.split_hz]\nmax = 1e-3\n", encoding="utf-8")
    for limits in (table, tmp_path / "limits.toml", str(tmp_path / "limits.toml"), gs.load_limits(table)):
        found = gs.identify(healthy(), limits=limits)
        assert (found.columns["verdict"], found.columns["failed_limits"]) == ("fail", "split_hz")
        assert "verdict by the given limits: fail" in str(found)
    assert "verdict" not in gs.identify(healthy()).columns


def test_what_was_read_prints_in_short_and_is_drawn():
    campaign = healthy()
    assert len(repr(campaign).splitlines()) == 1 + len(campaign.records)
    assert "samples at" in repr(campaign.records[0])
    f = np.linspace(500.0, 520.0, 50)
    record = ToneRecord("up.csv", "sweep", f, np.ones((50, 1), complex), np.exp(1j * f)[:, None])
    assert "50 rows" in repr(record)
    decay = EnvelopeRecord("decay.csv", np.linspace(0.0, 1.0, 50), np.exp(-f)[:, None] + 1e-9)
    for read in (
        ToneCampaign("a", (record,), Instrument(1.0)),
        ToneCampaign("a", (), Instrument(1.0), envelopes=(decay,)),
    ):
        assert isinstance(gs.figures.channels(read), Figure)
    assert isinstance(gs.figures.channels(campaign), Figure)
    made = gs.simulate({"split_hz": 1.5}, seed=3)
    assert "split" not in repr(made).partition("true: ")[0]
    assert "f1_hz = " in repr(made)


def test_a_run_is_exported_from_python(stored, tmp_path):
    files = gs.open_run(results=stored).export(tmp_path / "night.stdf")
    assert files == (tmp_path / "night.stdf",)
    assert files[0].read_bytes()[4:6] == bytes([2, 4])
    with pytest.raises(UsageError, match="suffix of no format"):
        gs.open_run(results=stored).export(tmp_path / "night.doc")
