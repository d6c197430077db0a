"""A mistake in a user's effect or irregularity: one typed message with file, line and statement, exit code 2."""

import sys
from pathlib import Path

import pytest
from stub_runs import stub_block, stub_runs

from pipeline.user_code import fault_of
from populations.draw import draw
from workflows.cli import call
from workflows.screening.settings import population

EFFECT = '''"""Some film."""
import math

import numpy as np
from numba import njit
from pipeline.device.effect import Effect
from pipeline.device.parameters import Parameter


def helper(x):
    return x * x


def force(t, q, qd, u, p, laws, out):
    for i in range(laws.axes):
        out[i] -= p[0] * q[i]


def drive(v, p, context):
    return v + p[0] * v**2


EFFECT = Effect(
    name="mine",
    law="a",
    source="b",
    signature="c",
    parameters=(Parameter("s", "1/s", 0.0, 1e12, "size", scale=1e6),),
    force=force,
)
'''
LAW = "        out[i] -= p[0] * q[i]\n"
HEAD = "def force(t, q, qd, u, p, laws, out):"
#: name -> what is replaced, by what, the line of the mistake, words of the message.
MISTAKES = {
    "a misspelt name": (LAW, LAW.replace("q[i]", "qx[i]"), 16, ("NameError", "qx")),
    "a misspelt function": (LAW, LAW.replace("q[i]", "math.sinn(q[i])"), 16, ("math", "sinn")),
    "a field that Laws lacks": (LAW, LAW.replace("q[i]", "laws.dampingg[i, i]"), 16, ("Laws", "dampingg")),
    "too many indices": (LAW, LAW.replace("q[i]", "q[i, 0]"), 16, ("IndexError", "1-dimensional")),
    "an array for a number": (LAW, LAW.replace("q[i]", "q"), 16, ("ValueError",)),
    "too many arguments": (LAW, LAW.replace("q[i]", "math.sin(q[i], 2)"), 16, ("TypeError", "sin")),
    "a call that numba lacks": (LAW, LAW.replace("q[i]", "np.fft.rfft(q)[0].real"), 16, ("rfft", "numpy.fft")),
    "text in a force": (LAW, LAW.replace("q[i]", "float('%d' % i)"), 16, ("numba cannot compile", "mod(")),
    "a helper that is not compiled": (LAW, LAW.replace("q[i]", "helper(q[i])"), 16, ("helper", "@numba.njit")),
    "a mistake in a helper": (LAW, LAW.replace("q[i]", "helper(out)[0][0]"), 16, ("IndexError", "scalar")),
    "an import inside a force": (LAW, "        import cmath\n" + LAW, 16, ("does not compile",)),
    "a force that returns": (LAW, LAW + "    return out\n", 17, ("adds to out",)),
    "a missing argument": (HEAD, HEAD.replace(", laws", ""), None, ("TypeError", "positional arguments")),
    "a drive of the wrong shape": ("    return v + p[0] * v**2\n", "    return v[:, :1]\n", 20, ("shape", "(N, drives)")),
    "a drive with two results": ("    return v + p[0] * v**2\n", "    return v, p\n", 20, ("tuple", "(N, drives)")),
    "a misspelt field of the declaration": ("    law=", "    laww=", 23, ("laww",)),
    "an empty field of the declaration": ('    source="b",', '    source="",', 23, ("source",)),
    "a null out of range": ("0.0, 1e12", "1.0, 1e12", 23, ("low <= null <= high", "'s'")),
    "a syntax error": ("range(laws.axes):", "range(laws.axes)", 15, ("SyntaxError",)),
    "a missing module": ("import math\n", "import maths\n", 2, ("ModuleNotFoundError", "maths")),
}  # fmt: skip


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_in_an_effect_names_file_line_and_statement(case, tmp_path, capsys):
    old, new, line, words = MISTAKES[case]
    assert old in EFFECT
    text = EFFECT.replace(old, new, 1)
    if "def drive" in old or ("v" in new and "drive" in case):
        text = text.replace("force=force", "drive=drive")
    file = tmp_path / "mine.py"
    file.write_text(text, encoding="utf-8")
    assert call(["model", "add", "mine", str(tmp_path / "model.toml"), "--effects", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(word in error for word in words), error
    assert "nopython" not in error
    assert "next:" in error
    if line is not None:
        assert f"{file}, line {line}:" in error, error
        assert repr(text.splitlines()[line - 1].strip()) in error
    else:
        assert str(file) in error


def test_the_example_without_a_mistake_is_accepted(tmp_path):
    (tmp_path / "mine.py").write_text(EFFECT, encoding="utf-8")
    assert call(["model", "add", "mine", str(tmp_path / "model.toml"), "--effects", str(tmp_path)]) == 0


def test_arithmetic_that_fails_only_at_the_sample_is_accepted(tmp_path):
    text = EFFECT.replace(LAW, "        out[i] -= p[0] * math.sqrt(-1.0 - abs(q[i]))\n")
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    assert call(["model", "add", "mine", str(tmp_path / "model.toml"), "--effects", str(tmp_path)]) == 0


IRREGULARITY = '''"""Masses of the leaves."""
from populations.irregularity import Change, Irregularity, Parameter


def act(p, site):
    return Change(anisotropy=0.01 * p["die_pct"] * site.complex_normal("die"))


IRREGULARITY = Irregularity(
    name="leaf_mass",
    stage="fabrication",
    parameters=(Parameter("die_pct", "%", 0.0, 5.0, "sd from die to die"),),
    source="assumed",
    act=act,
)
'''
FAULTS = {
    "a misspelt parameter": ('p["die_pct"]', 'p["diepct"]', 6, ("KeyError", "diepct")),
    "a misspelt method": ("complex_normal", "complexnormal", 6, ("AttributeError", "complexnormal")),
    "a wrong shape": ('site.complex_normal("die")', 'site.complex_normal("die")[None]', 6, ("anisotropy", "shape")),
    "a complex number for a real one": ("anisotropy=", "ln_area=", 6, ("ln_area", "real numbers")),
    "no result": ("    return Change(", "    Change(", 5, ("nothing", "Change")),
    "a wrong kind of result": ("Change(anisotropy=0.01", "dict(anisotropy=0.01", 6, ("dict", "Change")),
    "an unknown field": ("Change(anisotropy=", "Change(anisotrop=", 6, ("TypeError", "anisotrop")),
    "a misspelt declaration": ("    source=", "    sourse=", 9, ("TypeError", "sourse")),
    "a syntax error": ("def act(p, site):", "def act(p, site)", 5, ("SyntaxError",)),
    "a missing import": ("import Change, ", "import ", 6, ("NameError", "Change")),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_mistake_in_an_irregularity_names_file_line_and_statement(case, tmp_path, capsys):
    old, new, line, words = FAULTS[case]
    assert old in IRREGULARITY
    file = tmp_path / "mine" / "leaf_mass.py"
    file.parent.mkdir()
    file.write_text(IRREGULARITY.replace(old, new, 1), encoding="utf-8")
    assert call(_dry_run(tmp_path)) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(word in error for word in words), error
    assert f"{file}, line {line}:" in error, error


def test_the_irregularity_without_a_mistake_is_accepted(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "leaf_mass.py").write_text(IRREGULARITY, encoding="utf-8")
    assert call(_dry_run(tmp_path)) == 0


def _dry_run(folder: Path) -> list[str]:
    """Arguments of a dry run of a population with the irregularity."""
    import populations

    shipped = (Path(populations.__file__).parent / "specs" / "cloverleaf.toml").read_text(encoding="utf-8")
    head = 'irregularity_folders = ["mine"]\n'
    (folder / "fab.toml").write_text(f"{head}{shipped}\n[irregularity.leaf_mass]\ndie_pct = 0.1\n", encoding="utf-8")
    (folder / "run.toml").write_text('[run]\ndevices = 2\n[source]\nspec = "fab.toml"\n', encoding="utf-8")
    return ["run", str(folder / "run.toml"), "--dry-run"]


def test_a_fault_that_shows_later_is_still_that_of_the_users_file(tmp_path):
    from pipeline.device.effect import load_effect

    file = tmp_path / "mine.py"
    file.write_text(EFFECT.replace("    return v + p[0] * v**2", "    return v[p[0] > 9.0, 0, 0]"), encoding="utf-8")
    load_effect(str(file))
    module = next(one for one in sys.modules.values() if getattr(one, "__file__", None) == str(file))
    try:
        module.drive([[1.0]], [1.0], None)
    except TypeError as error:
        found = fault_of(error)
    assert found is not None
    assert f"{file}, line 20:" in str(found)
    assert fault_of(ValueError("elsewhere")) is None


@pytest.mark.parametrize(("decorator", "line"), [("", 11), ("@njit\n", 12)])
def test_a_mistake_in_a_helper_is_named_where_it_is(decorator, line, tmp_path, capsys):
    text = EFFECT.replace("def helper", f"{decorator}def helper").replace("return x * x", "return x.real_part")
    (tmp_path / "mine.py").write_text(text.replace("p[0] * q[i]", "p[0] * helper(q[i])"), encoding="utf-8")
    assert call(["model", "add", "mine", str(tmp_path / "model.toml"), "--effects", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "real_part" in error
    assert f"mine.py, line {line}:" in error, error


def test_a_corrected_file_is_read_again_in_the_same_process(tmp_path, capsys):
    file, arguments = (
        tmp_path / "mine.py",
        ["model", "add", "mine", str(tmp_path / "model.toml"), "--effects", str(tmp_path)],
    )
    file.write_text(EFFECT.replace("p[0] * q[i]", "p[0] * qx[i]"), encoding="utf-8")
    assert call(arguments) == 2
    file.write_text(EFFECT, encoding="utf-8")
    assert call(arguments) == 0
    leaf = tmp_path / "mine" / "leaf_mass.py"
    leaf.parent.mkdir()
    leaf.write_text(IRREGULARITY.replace("complex_normal", "complexnormal_"), encoding="utf-8")
    assert call(_dry_run(tmp_path)) == 2
    leaf.write_text(IRREGULARITY, encoding="utf-8")
    assert call(_dry_run(tmp_path)) == 0


def test_a_fault_of_later_devices_names_the_users_file_and_not_the_copy_of_the_run(tmp_path, monkeypatch, capsys):
    def drawn(source, at):
        draw(population(source[0]), 1, at.first, at.count)
        return stub_block()(source, at)

    stub_runs(monkeypatch, drawn)
    file = tmp_path / "mine" / "leaf_mass.py"
    file.parent.mkdir()
    later = '    if site.index.max() >= 30:\n        p["absent"]\n    return Change('
    file.write_text(IRREGULARITY.replace("    return Change(", later), encoding="utf-8")
    arguments = [one for one in _dry_run(tmp_path) if one != "--dry-run"]
    config = tmp_path / "run.toml"
    config.write_text(
        config.read_text(encoding="utf-8").replace("devices = 2", "devices = 40\nblock = 10"), encoding="utf-8"
    )
    assert call([*arguments, "--out", str(tmp_path / "results")]) == 2
    error = capsys.readouterr().err
    assert f"{file}, line 7: KeyError: 'absent'" in error, error
