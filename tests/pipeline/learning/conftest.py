"""A problem without gyros, whose answers have every key that does not depend on the kind of measurement."""

import pytest
from straight_lines import Toy


@pytest.fixture(scope="session")
def toy() -> Toy:
    return Toy()
