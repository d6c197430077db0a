"""The primitives of the limits, the reference loop among them."""

import pytest
from bench.primitives import PRIMITIVES


@pytest.mark.parametrize("name", PRIMITIVES)
def test_primitive(timed, name):
    primitive = PRIMITIVES[name]
    timed.primitive(name, primitive.work, primitive.count)
