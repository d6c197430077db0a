"""The loops that are compiled before a run are those that it uses, and the cache is asked whether it holds them."""

from __future__ import annotations

import importlib
import json
import sys
from types import SimpleNamespace

import pytest
from numba import types
from numba.core.dispatcher import Dispatcher

from pipeline.compiled_loops import is_cached
from tests.workflows.test_ahead import python
from workflows.screening import compiling

#: Loops of the examination, which blocks do without.
EXAMINATION = ("pipeline.experiment.forward.",)
#: A loop that the driver has compiled when the workers start: it needs it to plan a run.
DRIVER = "pipeline.experiment.forward.recursion._run_lanes"
BLOCK = """
import json, sys
from numba.core.dispatcher import Dispatcher
from workflows.config import load_config
from workflows.screening import compiling
from workflows.screening.block import DeviceBlock, virtual_block

def loops():
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("pipeline.")]
    found = {id(x): x for module in modules for x in vars(module).values() if isinstance(x, Dispatcher)}
    return {f"{x.py_func.__module__}.{x.py_func.__name__}": x for x in found.values()}

def compiled():
    return {name: len(x.signatures) for name, x in loops().items()}

if sys.argv[1] == "first":
    for loop, types in compiling.typed_loops():
        loop.compile(types)
before = compiled()
virtual_block(load_config(None), DeviceBlock(0, 0, 5))
found = loops()
print(json.dumps({
    "more": [name for name, count in compiled().items() if count > before.get(name, 0)],
    "unused": [
        f"{x.py_func.__module__}.{x.py_func.__name__}"
        for x, types in compiling.typed_loops()
        if types not in x.signatures
    ],
}))
"""


def test_a_block_uses_the_loops_that_are_compiled_before_it_and_no_others():
    first, after = (json.loads(python("-c", BLOCK, when)) for when in ("first", "not"))
    assert set(first["more"]) <= {DRIVER}
    assert [name for name in after["unused"] if not name.startswith(EXAMINATION)] == []


def test_a_loop_is_cached_for_its_types_until_its_source_changes(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    source = tmp_path / "loop_that_changes.py"

    def loop(text: str) -> Dispatcher:
        source.write_text(f"from numba import njit\n@njit(cache=True)\ndef twice(x):\n    return {text}\n")
        sys.modules.pop(source.stem, None)
        importlib.invalidate_caches()
        return importlib.import_module(source.stem).twice

    first = loop("2.0 * x")
    assert not is_cached(first, (types.float64,))
    first.compile((types.float64,))
    assert is_cached(loop("2.0 * x"), (types.float64,))
    assert not is_cached(loop("2.0 * x"), (types.int64,))
    assert not is_cached(loop("x + x + 0.0"), (types.float64,))


@pytest.mark.parametrize(("local", "compiled"), [(None, False), (object(), True)])
def test_nothing_is_compiled_before_a_run_on_other_machines_or_where_all_is_cached(local, compiled, monkeypatch, capfd):
    monkeypatch.setattr(compiling, "is_compiled", lambda: compiled)
    monkeypatch.setattr(compiling, "in_parallel", lambda *_: pytest.fail("it was"))
    compiling.compile_loops(SimpleNamespace(local_workers=local), quiet=False)
    assert capfd.readouterr().err == ""


def test_every_loop_is_compiled_once_and_the_user_is_told(monkeypatch, capfd):
    asked: list[int] = []

    def parallel(client, function, constant, items):
        asked.extend(items)
        yield from items

    monkeypatch.setattr(compiling, "is_compiled", lambda: False)
    monkeypatch.setattr(compiling, "in_parallel", parallel)
    compiling.compile_loops(SimpleNamespace(local_workers=object()), quiet=False)
    assert asked == list(range(len(compiling.needed_loops())))
    assert "once on this machine" in capfd.readouterr().err
