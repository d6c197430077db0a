"""A problem without gyros, for the tests of criticism."""

import pytest
from straight_lines import Toy


@pytest.fixture(scope="session")
def toy() -> Toy:
    return Toy()
