"""Populations that extend others, their description as a complete file, and files that are changed by name."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ConfigError
from populations.describe import described, levels_of
from populations.draw import Draw, draw
from populations.edit import added, dropped
from populations.extend import chain
from populations.irregularity import find
from populations.spec import DEFAULT, PopulationSpec, load_spec

OWN = """
from populations.irregularity import Change, Irregularity, Parameter

def act(p, site):
    return Change(anisotropy=0.01 * p["die_pct"] * site.complex_normal("die"))

IRREGULARITY = Irregularity(name="leaf_mass", stage="fabrication",
    parameters=(Parameter("die_pct", "%", 0.0, 5.0, "sd per component from die to die"),), source="assumed", act=act)
"""


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def same_devices(one: PopulationSpec, other: PopulationSpec) -> bool:
    """Whether both draw the same devices, to the bit."""
    first, second = (draw(spec, 3, 990, 60) for spec in (one, other))
    return all(_bits(first, name) == _bits(second, name) for name in first.true)


def _bits(drawn: Draw, name: str) -> bytes:
    return np.concatenate([drawn.true[name], drawn.fab[name]]).tobytes()


def test_a_file_states_only_what_differs(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "narrow.toml",
        'extends = "cloverleaf"\nwithout = ["lid_leak"]\n[wafer]\npitch_mm = 6.0\n[irregularity.spring_width]\nlot_um = 0.05\n',
    )
    base, found = load_spec(), load_spec(path)
    assert found.name == base.name
    assert found.device == base.device
    assert (found.wafer.pitch_mm, found.wafer.diameter_mm) == (6.0, base.wafer.diameter_mm)
    assert "lid_leak" not in found.irregularity
    assert found.irregularity["spring_width"] == {**base.irregularity["spring_width"], "lot_um": 0.05}
    assert found.irregularity.keys() == base.irregularity.keys() - {"lid_leak"}


def test_a_chain_is_resolved_from_its_end_and_folders_are_relative_to_the_file_that_names_them(tmp_path: Path) -> None:
    written(tmp_path, "base/mine/leaf_mass.py", OWN)
    written(
        tmp_path,
        "base/leaf.toml",
        'name = "leaf"\nextends = "cloverleaf"\nirregularity_folders = ["mine"]\n[irregularity.leaf_mass]\ndie_pct = 0.1\n',
    )
    path = written(tmp_path, "top.toml", 'extends = "base/leaf.toml"\n[irregularity.leaf_mass]\ndie_pct = 0.2\n')
    found = load_spec(path)
    assert found.name == "leaf"
    assert found.irregularity_folders == (str((tmp_path / "base" / "mine").resolve()),)
    assert found.irregularity["leaf_mass"] == {"die_pct": 0.2}
    assert [one.name for one in chain(path)] == ["top.toml", "leaf.toml", "cloverleaf.toml"]


@pytest.mark.parametrize(
    ("text", "says", "shows"),
    [
        ('extends = "clover"\n', "unknown population", "did you mean cloverleaf?"),
        ('extends = "gone.toml"\n', "cannot be read", "gone.toml"),
        ("extends = 3\n", "extends is not valid", "cloverleaf, or the path"),
        ('extends = "own.toml"\n', "extends itself", "own.toml -> own.toml"),
        ('extends = "other.toml"\n', "extends itself", "own.toml -> other.toml -> own.toml"),
        ('extends = "cloverleaf"\nwithout = ["lid_leek"]\n', "unknown irregularity", "did you mean lid_leak?"),
        ('extends = "cloverleaf"\nwithout = "lid_leak"\n', "without is not valid", "a list of names"),
        (
            'extends = "cloverleaf"\nwithout = ["lid_leak"]\n[irregularity.lid_leak]\nfraction = 0.1\n',
            "that the file states",
            "one of the two",
        ),
        ('name = "x"\nwithout = ["lid_leak"]\n', "without belongs to a file that extends", "write extends"),
        ('extends = "cloverleaf"\nwithoutt = ["lid_leak"]\n', "unknown key", "did you mean without?"),
        ('extends = "cloverleaf"\n[irregularity.no_such]\na = 1.0\n', "unknown irregularity", "no_such"),
        ('extends = "cloverleaf"\n[irregularity.lid_leak]\nfraction = 2.0\n', "out of range", "0 to 1"),
        ('extends = "cloverleaf"\n[wafer]\npitch_mm = "wide"\n', "wafer.pitch_mm is not valid", "a number"),
        ('extends = "cloverleaf"\nirregularity = 3\n', "irregularity is not valid", "a table"),
        ('extends = "cloverleaf"\ndevice = 3\n', "device is not valid", "a table"),
        ('extends = "cloverleaf"\n[irregularity.lid_leak]\nfraction = nan\n', "not finite", "a finite number"),
    ],
)  # fmt: skip
def test_wrong_extensions_are_config_errors_that_name_the_fault(
    tmp_path: Path, text: str, says: str, shows: str
) -> None:
    written(tmp_path, "other.toml", 'extends = "own.toml"\n')
    path = written(tmp_path, "own.toml", text)
    with pytest.raises(ConfigError) as caught:
        load_spec(path)
    assert says in str(caught.value)
    assert shows in str(caught.value)


def test_the_described_population_draws_the_same_devices_to_the_bit(tmp_path: Path) -> None:
    for spec in (
        load_spec(),
        load_spec().with_values({"residual_anisotropy": 1.0 / 3.0, "spring_width.lot_um": 0.1 + 0.2}),
    ):
        again = load_spec(written(tmp_path, "whole.toml", described(spec)))
        assert same_devices(spec, again)
        assert described(again) == described(spec), "the description does not describe itself"


@given(st.text(max_size=30))
def test_a_population_of_any_name_is_described_as_a_file_that_reads_back(name: str) -> None:
    spec = msgspec.structs.replace(load_spec(), name=name)
    again = load_spec(Path("any.toml"), described(spec))
    assert (again.name, again.device) == (spec.name, spec.device)


def test_every_irregularity_of_the_library_is_described_also_one_of_the_user(tmp_path: Path) -> None:
    written(tmp_path, "mine/leaf_mass.py", OWN)
    path = written(
        tmp_path, "own.toml", 'extends = "cloverleaf"\nwithout = ["lid_leak"]\nirregularity_folders = ["mine"]\n'
    )
    spec = load_spec(path)
    text = described(spec)
    tables = tomllib.loads(text)["irregularity"]
    assert tables.keys() == find().keys() - {"lid_leak"}
    for name, irregularity in find(spec.irregularity_folders).items():
        assert f"[irregularity.{name}]" in text
        for parameter in irregularity.parameters:
            assert any(parameter.name in line and parameter.meaning in line for line in text.splitlines()), (
                f"{name}.{parameter.name} is not described"
            )
    assert "# Not in this population: leaf_mass\n" in text
    # What is a comment in the description is in the population when the comment signs go.
    uncommented = "".join(
        line.removeprefix("# ") if line.startswith(("# [irregularity.leaf_mass]", "# die_pct = 0.0")) else line
        for line in text.splitlines(keepends=True)
    )
    assert load_spec(path, uncommented).irregularity["leaf_mass"] == {"die_pct": 0.0}


def test_levels_are_those_between_which_devices_differ() -> None:
    levels = levels_of(load_spec())
    assert levels["spring_thickness"] == ("lot", "wafer", "die")
    assert levels["lid_leak"] == ("package",)
    assert levels["tester_gain"] == ("tester",)
    assert levels["sidewall_tilt"] == ()


def test_add_makes_a_file_that_extends_the_shipped_population_and_changes_no_device(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    text = added("spring_width", path, None)
    assert tomllib.loads(text)["extends"] == "cloverleaf"
    spec = load_spec(path, text)
    assert spec.name == "mine"
    assert same_devices(spec, load_spec())
    assert "# 0 to 5 um, default 0: sd of the lot mean" in text


def test_drop_and_add_are_opposites_and_leave_the_other_lines_alone(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    text = (
        '# mine\nextends = "cloverleaf"  # the base\n\n[wafer]\npitch_mm = 6.0  # small\n\n'
        "# wider\n[irregularity.lid_leak]\nfraction = 0.1\n"
    )
    without = dropped("lid_leak", path, text)
    assert "lid_leak" not in load_spec(path, without).irregularity
    assert without.startswith('# mine\nextends = "cloverleaf"  # the base\nwithout = ["lid_leak"]\n')
    assert "pitch_mm = 6.0  # small\n" in without
    assert "# wider" not in without, "the comment of the table remains"
    twice = dropped("spring_width", path, without)
    assert 'without = ["lid_leak", "spring_width"]\n' in twice
    back = added("lid_leak", path, added("spring_width", path, twice))
    assert "without" not in back
    assert same_devices(load_spec(path, back), load_spec(path, 'extends = "cloverleaf"\n[wafer]\npitch_mm = 6.0\n'))


def test_drop_takes_a_table_from_the_middle_of_a_complete_file(tmp_path: Path) -> None:
    path, text = tmp_path / "own.toml", described(load_spec())
    less = dropped("lid_leak", path, text)
    removed = [line for line in text.splitlines() if line not in less.splitlines()]
    assert "[irregularity.lid_leak]" in removed
    assert set(removed) <= set(text[text.index("# Leaking lids") : text.index("# Gas pressure under")].splitlines())
    assert load_spec(path, less).irregularity.keys() == find().keys() - {"lid_leak"}


@pytest.mark.parametrize(
    ("text", "name", "says"),
    [
        ('extends = "cloverleaf"\n[irregularity]\nlid_leak = { fraction = 0.1 }\n', "lid_leak", "cannot be changed"),
        ('extends = "cloverleaf"\nwithout = ["lid_leak"]\n', "lid_leak", "unknown irregularity"),
        ('extends = "cloverleaf"\n', "lid_leek", "did you mean lid_leak?"),
    ],
)
def test_what_cannot_be_dropped_is_refused(tmp_path: Path, text: str, name: str, says: str) -> None:
    with pytest.raises(ConfigError, match=r"lid_lee?a?k") as caught:
        dropped(name, tmp_path / "own.toml", text)
    assert says in str(caught.value)


def test_what_is_there_cannot_be_added(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="states this irregularity already"):
        added("lid_leak", tmp_path / "own.toml", DEFAULT.read_text(encoding="utf-8"))
    with pytest.raises(ConfigError, match="unknown irregularity"):
        added("no_such", tmp_path / "own.toml", None)
