"""STDF files by pystdf (GPL, installed by hand in an environment of its own) beside the reader of the tests.

`python tests/measure/read_stdf.py FILE..` prints the records of each kind and the fields in which the two readers differ.
"""

import math
import sys
from collections import Counter
from pathlib import Path

from pystdf.IO import Parser

sys.path.insert(0, str(Path(__file__).parents[1]))
from stdf_reader import records


class _Kept:
    """The records that pystdf sends."""

    def __init__(self) -> None:
        self.found: list = []

    def after_send(self, _: object, data: tuple) -> None:
        kind, values = data
        self.found.append((type(kind).__name__.upper(), dict(zip(kind.fieldNames, values))))


def by_pystdf(file: Path) -> list:
    """Name and fields of each record."""
    kept = _Kept()
    with file.open("rb") as stream:
        parser = Parser(inp=stream)
        parser.addSink(kept)
        parser.parse()
    return kept.found


def main(files: list[Path]) -> None:
    """Print counts and differences."""
    for file in files:
        theirs, ours = by_pystdf(file), list(records(file.read_bytes()))
        different = sum(
            name != other or any(not _same(value, values.get(field)) for field, value in fields.items())
            for (name, fields), (other, values) in zip(ours, theirs, strict=True)
        )
        counts = ", ".join(f"{count} {name}" for name, count in Counter(name for name, _ in theirs).items())
        print(f"{file.name}: {counts}; {different} of {len(ours)} records differ")


def _same(ours: object, theirs: object) -> bool:
    if isinstance(ours, float) and isinstance(theirs, float):
        return ours == theirs or (math.isnan(ours) and math.isnan(theirs))
    return ours == theirs


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
