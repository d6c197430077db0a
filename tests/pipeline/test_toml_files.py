"""Every fault of a TOML file is one typed error that names the file, the key, the value, what is allowed and the next step."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta, Struct

from pipeline.errors import ConfigError, GyroscreenError
from pipeline.experiment.campaign import read_campaign
from pipeline.experiment.files.modal_record import read_modal_record
from pipeline.input_limits import TOML_BYTES
from pipeline.toml_files import MAY_BE_INFINITE, converted, decode, load, read_bytes, table
from workflows.config import RunConfig, load_config


class Inner(Struct, frozen=True, forbid_unknown_fields=True):
    count: Annotated[int, Meta(ge=1, le=64)]
    share: Annotated[float, Meta(gt=0.0, lt=1.0)] = 0.5


class Texts(Struct):
    a: str
    b: str
    c: str


class Outer(Struct, frozen=True, forbid_unknown_fields=True):
    inner: Inner | Literal[False] = False
    many: Annotated[tuple[Inner, ...], Meta(min_length=1)] = (Inner(1),)
    values: dict[str, float | dict[str, float]] = {}
    pair: tuple[float, float] | None = None
    limit: Annotated[float, Meta(gt=0.0, extra=MAY_BE_INFINITE)] = 1.0
    hold: Literal["zoh", "foh"] = "zoh"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "colour = 1",
            "f.toml: unknown key at the top level: 'colour'; allowed: inner, many, values, pair, limit, hold",
        ),
        (
            "inner = { count = 2, shares = 1 }",
            "f.toml: unknown key in inner: 'shares'; allowed: count, share; next: did",
        ),
        ("[inner]", "f.toml: a key is missing in inner: 'count'; allowed: count, share; next: write count"),
        (
            "inner = { count = 65 }",
            "f.toml: inner.count is not valid: 65; allowed: a whole number from 1 to 64; next: c",
        ),
        ("inner = true", "f.toml: inner is not valid: True; allowed: a table with the keys count, share or false"),
        ("[[many]]\ncount = 1\nshare = 0.0", "f.toml: many[0].share is not valid: 0.0; allowed: a number above 0 and"),
        ("many = []", "f.toml: many is not valid: []; allowed: a list that is not empty"),
        ("[values]\na = 'x'", "f.toml: values.a is not valid: 'x'; allowed: a number or a table"),
        ("[values.a]\nb = 'x'", "f.toml: values.a.b is not valid: 'x'; allowed: a number"),
        ("[values.a]\nb = -inf", "f.toml: values.a.b is not finite: -inf; allowed: a finite number"),
        ("pair = [1.0]", "f.toml: pair is not valid: [1.0]; allowed: [a number, a number]"),
        ("pair = [1.0, nan]", "f.toml: pair[1] is not finite: nan; allowed: a finite number; next: correct pair[1]"),
        ("limit = nan", "f.toml: limit is not valid: nan; allowed: a number above 0"),
        ("hold = 'zoo'", "f.toml: hold is not valid: 'zoo'; allowed: zoh, foh; next: correct hold"),
        ("hold = ", "f.toml is not TOML"),
    ],
)
def test_the_message_names_file_key_value_range_and_next_step(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        decode(text.encode(), Outer, "f.toml")
    assert str(error.value).startswith(message)


def test_infinity_is_refused_except_where_it_is_declared() -> None:
    assert decode(b"limit = inf", Outer, "f.toml").limit == float("inf")


def test_a_file_that_is_missing_or_a_folder_is_a_config_error_that_says_what_to_do(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(
            ConfigError, match=r"limits file cannot be read: .*next: check the path, or start from a copy"
        ):
            load(path, Outer, "limits file", "start from a copy")


@given(st.dictionaries(st.text(max_size=5), st.one_of(st.booleans(), st.floats(), st.text(), st.lists(st.integers()))))
def test_any_table_converts_or_is_a_config_error(tree: dict[str, object]) -> None:
    with suppress(ConfigError):
        assert isinstance(converted(tree, Outer, "f.toml"), Outer)


MODE = "[[mode]]\nfrequency_hz = 500.0\nzeta = 1e-3\nR1 = [[1.0]]\nR0 = [[1.0]]\n"


@pytest.mark.parametrize(
    ("key", "value", "valid"),
    [
        ("adc", "{ bits = 1, full_scale_v = 1.0 }", True),
        ("adc", "{ bits = 64, full_scale_v = 1.0 }", True),
        ("adc", "{ bits = 0, full_scale_v = 1.0 }", False),
        ("adc", "{ bits = 65, full_scale_v = 1.0 }", False),
        ("adc", "{ bits = 16, full_scale_v = 0.0 }", False),
        ("antialias", "{ order = 32, corner_hz = 4800.0 }", True),
        ("antialias", "{ order = 33, corner_hz = 4800.0 }", False),
        ("phase_error_deg", "89.0", True),
        ("phase_error_deg", "90.0", False),
    ],
)
def test_a_run_a_campaign_and_a_modal_record_allow_the_same_values(
    tmp_path: Path, key: str, value: str, valid: bool
) -> None:
    header = "[demodulation]" if key == "phase_error_deg" else "[instrument]"
    entry = f"{header}\n{key} = {value}\n"
    (tmp_path / "run.toml").write_text(entry)
    (tmp_path / "campaign.toml").write_text(entry + '[[record]]\nfile = "a.csv"\n')
    lines = "".join(f"{n / 1000.0},0.0,{float(n % 2)}\n" for n in range(100))
    (tmp_path / "a.csv").write_text("time_s,drive1_V,sense1_V\n" + lines)
    own = f"{key} = {value}\n" if key == "antialias" else entry if key == "phase_error_deg" else ""
    (tmp_path / "modal.toml").write_text('kind = "modal"\n' + own + MODE)
    for read, name in ((load_config, "run.toml"), (read_campaign, "campaign.toml"), (read_modal_record, "modal.toml")):
        if valid or (name == "modal.toml" and key == "adc"):
            read(tmp_path / name)
        else:
            with pytest.raises(ConfigError, match=rf"{name}: .*{key}.* is not valid"):
                read(tmp_path / name)


def test_a_campaign_states_its_filter_and_converter_in_full(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("[instrument]\nadc = { bits = 12 }\nantialias = { order = 4 }\n")
    instrument = load_config(tmp_path / "run.toml").instrument.instrument()
    assert instrument.adc is not None
    assert instrument.antialias is not None
    assert (instrument.adc.full_scale_v, instrument.antialias.corner_hz) == (10.0, 4800.0)
    (tmp_path / "campaign.toml").write_text('[instrument]\nadc = { bits = 12 }\n[[record]]\nfile = "a.csv"\n')
    with pytest.raises(ConfigError, match=r"a key is missing in instrument\.adc: 'full_scale_v'"):
        read_campaign(tmp_path / "campaign.toml")


def test_a_written_table_reads_back_to_the_same_values() -> None:
    values = {"inner": {"count": 3, "share": 0.1}, "pair": [1e-300, -2.5], "hold": "foh"}
    read = decode(table("", values).encode(), Outer, "f.toml")
    assert (read.inner, read.pair, read.hold) == (Inner(3, 0.1), (1e-300, -2.5), "foh")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[systematic]\nphase_error_sd_deg = 0.5\n[posterior]\nstored_draws = 20\n", "stored_draws"),
        ("[systematic]\nphase_error_sd_deg = 5.0\n[demodulation]\nphase_error_deg = 45.0\n", "may reach 90 deg"),
        ("[systematic]\nclock_sd_ppm = -1.0\n", "clock_sd_ppm"),
    ],
)
def test_common_errors_that_cannot_be_integrated_are_refused(tmp_path, text, named):
    (tmp_path / "run.toml").write_text(text)
    with pytest.raises(ConfigError, match=named):
        load_config(tmp_path / "run.toml")


@pytest.mark.parametrize("depth", [10, 300, 700, 100_000])
def test_deep_brackets_are_one_error(depth: int) -> None:
    for text in (b"a = " + b"[" * depth, b"[device]\nid = " + b"[" * depth + b"]" * depth):
        with pytest.raises(ConfigError):
            decode(text, RunConfig, "x.toml")


#: Each took up to 4 GB, or a minute, in the parser.
_EXPENSIVE = {
    "too many parts": ("a." * 50_000 + "a = 1", "a . " * 50_000 + "a = 1", "[" + "a." * 8 + "a]", "'b.c'." * 9),
    "nested too deeply": ("x = " + "[" * 17, "x = " + "{ a = " * 17, "a = '''[[[\n[['''\nb = " + "[" * 100_000),
    "too long": ("a" * 129 + " = 1", '"' + "a " * 100 + '" = 1', "a = " + "1" * 5000),
    "too large": ("#" * (TOML_BYTES + 1),),
    "not TOML": ('"' + '\\"' * 500_000, '"""' + '\\"""' * 250_000),
}


@pytest.mark.parametrize(("what", "texts"), _EXPENSIVE.items(), ids=_EXPENSIVE)
def test_shapes_that_cost_memory_are_refused_before_they_are_parsed(what: str, texts: tuple[str, ...]) -> None:
    for text in texts:
        with pytest.raises(ConfigError, match=what):
            decode(text.encode(), RunConfig, "x.toml")


def test_brackets_and_dots_in_strings_and_comments_do_not_count() -> None:
    deep, dotted = "[{" * 50, "x." * 50
    text = f'a = "{deep}{dotted}\\""  # {deep}\nb = \'\'\'{deep}\n\'\'\'\'\'\nc = """{deep}\\"""""\n'
    assert decode(text.encode(), Texts, "x.toml").b == deep + "\n''"


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "campaign.toml")
    with pytest.raises(GyroscreenError, match="not a regular file"):
        read_bytes(tmp_path / "campaign.toml")
