"""A sample of ``tests/measure/mutations.py``: mutated inputs end with a documented exit code and one message."""

import random

import pytest

from tests.measure.mutations import CASES
from workflows.cli import call


@pytest.mark.parametrize("kind", CASES)
def test_a_mutated_input_has_a_documented_exit_code_and_one_message(kind, tmp_path, capsys):
    for number in range(5 if kind == "init" else 15):  # init draws a picture of each
        what, arguments = CASES[kind](random.Random(f"suite-{kind}-{number}"), tmp_path)
        code = call(arguments)
        said = capsys.readouterr().err
        assert code in (0, 2, 5), (number, what, said)
        assert code == 0 or said.startswith("error: "), (number, what, said)
        assert "Traceback" not in said
