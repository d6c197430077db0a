"""The command line: wrong input gives one message and its exit code, without a traceback."""

import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from workflows.cli import call
from workflows.commands.groups.tasks import TASK_OF


def config(tmp: Path, text: str) -> list[str]:
    path = tmp / "run.toml"
    path.write_text(text)
    return ["run", str(path), "--out", str(tmp / "results")]


def record(tmp: Path, **changes: object) -> list[str]:
    t = np.arange(2000) / 10_000.0
    table = {"time_s": t, "drive1_V": t, "drive2_V": t, "sense1_V": t, "sense2_V": t}
    frame = pd.DataFrame(table)
    for name, value in changes.items():
        frame[name] = value
    if "drop" in changes:
        frame = frame.drop(columns=["sense1_V", "drop"]).rename(columns={"sense2_V": "senze2_V"})
    path = tmp / "record.csv"
    frame.to_csv(path, index=False)
    return ["identify", str(path)]


def with_nan(tmp: Path) -> list[str]:
    values = np.zeros(2000)
    values[777] = np.nan
    return record(tmp, sense1_V=values)


def without_runs(tmp: Path) -> list[str]:
    results = tmp / "results"
    results.mkdir()
    pd.DataFrame({"a": [1]}).to_parquet(results / "foreign.parquet")
    return ["report", "--results", str(results)]


def unwritable(tmp: Path) -> list[str]:
    (tmp / "file").write_text("not a folder")
    return ["run", "--devices", "1", "--out", str(tmp / "file")]


CASES = {
    "missing file": (lambda tmp: ["run", str(tmp / "none.toml")], 2, ("none.toml", "next:")),
    "unknown key": (lambda tmp: config(tmp, "[run]\ndevicez = 3\n"), 2, ("devicez", "devices")),
    "wrong type": (lambda tmp: config(tmp, '[run]\ndevices = "many"\n'), 2, ("run.devices", "many")),
    "wrong unit": (lambda tmp: config(tmp, "[noise]\nsigma_mv = 1.0\n"), 2, ("sigma_mv", "sigma_v")),
    "out of range": (
        lambda tmp: config(tmp, "[identification]\norder = 400\n"),
        2,
        ("identification.order", "400", "80"),
    ),
    "not a choice": (
        lambda tmp: config(tmp, '[instrument]\nhold = "zoo"\n'),
        2,
        ("instrument.hold", "zoo", "zoh", "bandlimited"),
    ),
    "no model file": (
        lambda tmp: ["model", "show", str(tmp / "none.toml")],
        2,
        ("none.toml", "no such file", "model add"),
    ),
    "nan in a record": (with_nan, 5, ("sense1_V", "777")),
    "wrong column": (lambda tmp: record(tmp, drop=0.0), 5, ("senze2_V", "sense")),
    "limits crossed": (lambda tmp: config(tmp, "[limits.split_hz]\nmin = 3.0\nmax = 1.0\n"), 2, ("split_hz", "3.0")),
    "zero devices": (lambda tmp: ["run", "--devices", "0", "--out", str(tmp)], 2, ("devices", "0")),
    "unwritable folder": (unwritable, 2, ("file", "--out")),
    "beyond any bench": (lambda tmp: config(tmp, "[limits.split_hz]\nmax = 1e308\n"), 2, ("split_hz.max", "1e+12")),
    "a rate beyond any converter": (
        lambda tmp: config(tmp, "[instrument]\nsample_rate_hz = 1e9\n"),
        2,
        ("too long", "samples", "sample_rate_hz"),
    ),
    "results at a URL": (lambda _: ["run", "--devices", "1", "--out", "s3://lot/nightly"], 2, ("s3:", "cluster.md")),
    "query at a URL": (lambda _: ["query", "SELECT 1", "--results", "s3://lot"], 2, ("s3:", "cluster.md")),
    "no run in the folder": (without_runs, 2, ("results", "gyroscreen run")),
    "unknown command": (lambda _: ["rum"], 2, ("rum",)),
    "a silent drive": (
        lambda tmp: config(tmp, "[experiment]\namplitude_v = [2.0, 0.0]\n"),
        2,
        ("drive 2 is silent", "2.0, 0.0", "amplitude_v"),
    ),
    "not TOML": (lambda tmp: config(tmp, "[run\n"), 2, ("TOML",)),
    "no scheduler": (
        lambda tmp: ["run", "--devices", "1", "--out", str(tmp), "--scheduler", "tcp://127.0.0.1:9"],
        2,
        ("tcp://127.0.0.1:9",),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_wrong_input_gives_one_message_and_its_exit_code(case, tmp_path, capfd):
    arguments, code, words = CASES[case]
    assert call(arguments(tmp_path)) == code
    captured = capfd.readouterr()
    assert captured.out == ""
    message = captured.err.strip().splitlines()
    assert len(message) == 1, captured.err
    assert message[0].startswith("error: ")
    for word in words:
        assert word in message[0]


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        ("SELEKT 1", ("SELEKT",)),
        ("SELECT nonsense FROM devices", ("nonsense",)),
        ("DROP VIEW devices", ("SELECT",)),
        ("SELECT * FROM read_csv('/etc/passwd')", ("read_csv",)),
    ],
)
def test_wrong_sql_gives_one_message(sql, words, tmp_path, capfd):
    from pipeline.store.provenance import provenance
    from pipeline.store.run import create_run
    from pipeline.store.schema import devices_table

    store = create_run(tmp_path, "r1", "", provenance(1))
    store.commit_block(0, devices_table({"device_id": ["D1"]}), None)
    store.finish("complete", {})
    assert call(["query", sql, "--results", str(tmp_path)]) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    for word in words:
        assert word in captured.err


def test_a_query_counts_one_run_and_names_it_where_there_are_several(tmp_path, capfd):
    from pipeline.store.provenance import provenance
    from pipeline.store.run import create_run
    from pipeline.store.schema import devices_table

    for name in ("r1", "r2"):
        store = create_run(tmp_path, name, "", provenance(1))
        store.commit_block(0, devices_table({"device_id": ["D1"], "wafer": ["W1"]}), None)
    arguments = ["query", "SELECT wafer, count(*) AS n FROM devices GROUP BY wafer", "--results", str(tmp_path)]
    for more, n, named in (([], 1, True), (["--run", "r1"], 1, False), (["--run", "all"], 2, False)):
        assert call([*arguments, "--format", "csv", *more]) == 0
        shown = capfd.readouterr()
        assert shown.out.splitlines()[1] == f'"W1",{n}'
        assert ("run r2, the latest of 2" in shown.err) is named
    assert call([*arguments, "--run", "r3"]) == 2


def test_the_version_is_that_of_the_distribution(capfd):
    assert call(["--version"]) == 0
    assert capfd.readouterr().out == f"gyroscreen {metadata.version('gyroscreen')}\n"


@pytest.mark.parametrize(
    ("group", "names"),
    [
        (
            [],
            "run rare query report attribute grr export verify identify paper init check simulate compare diagnose refine demo "
            "effects docs model population benchmark completion explore",
        ),
        (["model"], "show add drop export"),
        (["population"], "show add drop"),
        (
            ["benchmark"],
            "coverage undetected foreign-gyros sweeps decays rare efficiency throughput scaling faults sequential lattice "
            "silverbox hidden-effects trend",
        ),
    ],
)
def test_help_lists_every_command_with_its_full_summary(group, names, capfd):
    assert call([*group, "--help"]) == 0
    listed = capfd.readouterr().out.split("--help ")[1].splitlines()[1:]
    commands = [line for line in listed if line.startswith("  ")]
    found = [line.split()[0] for line in commands]
    # The root lists its commands by task: tasks.py has their order.
    assert sorted(found) == sorted(names.split()) if not group else found == names.split()
    assert not [line for line in commands if line.endswith("...")]
    assert len({line.index(line.split()[1]) for line in commands}) == 1  # one column of summaries


def test_help_groups_all_commands_by_task(capfd):
    assert call(["--help"]) == 0
    sections, task = {}, ""
    for line in capfd.readouterr().out.split("--help ")[1].splitlines()[1:]:
        task = line.removesuffix(":") if line and not line.startswith(" ") else task
        if line.startswith("  "):
            sections.setdefault(task, []).append(line.split()[0])
    assert list(sections) == [task for task in dict.fromkeys(TASK_OF.values()) if task in sections]
    for task, names in sections.items():
        assert names == [name for name in TASK_OF if TASK_OF[name] == task and name in names]
    assert sections["Screen a population"] == ["run", "rare"]


@pytest.mark.parametrize("arguments", [["--debug", "model", "show"], ["model", "show", "--debug"]])
def test_debug_shows_the_traceback_before_and_after_the_command(arguments, tmp_path, monkeypatch, capfd):
    missing = str(tmp_path / "none.toml")
    monkeypatch.setenv("GYROSCREEN_DEBUG", "")
    assert call(["model", "show", missing]) == 2
    assert "Traceback" not in capfd.readouterr().err
    assert call([*arguments, missing]) == 2
    shown = capfd.readouterr().err
    assert "Traceback" in shown
    assert shown.splitlines()[-1].startswith("error: ")


def test_help_imports_no_numerical_package():
    code = (
        "import sys; from workflows.cli import call; call(['--help']); call(['run', '--help']);"
        "print([name for name in ('numpy', 'scipy', 'pyarrow', 'dask', 'numba') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_the_loop_of_a_device_imports_nothing_of_lots(tmp_path):
    code = (
        "import sys; from workflows.cli import call;"
        f"code = call(['diagnose', {str(tmp_path)!r}]);"
        "print(code, [name for name in ('scipy.stats', 'pipeline.learning.lot', 'pipeline.store.run') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "campaign.toml" in done.stderr
    assert done.stdout.splitlines()[-1] == "5 []"


def test_a_worker_imports_no_report_and_no_statistics_package():
    heavy = (
        "scipy.stats",
        "scipy.signal",
        "scipy.optimize",
        "pandas",
        "matplotlib",
        "emcee",
        "pipeline.learning",
        "reports.run",
    )
    code = (
        "import sys; from pathlib import Path; from workflows.config import load_config;"
        "from workflows.screening.parts import BlockItem, block_task; from workflows.screening.plan import plan;"
        "planned = plan(load_config(None, {'devices': 1}));"
        "tables = block_task(planned.config, BlockItem(planned.blocks[0]), lambda device: None);"
        f"print(tables.statuses['ok'], [name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "1 []"
