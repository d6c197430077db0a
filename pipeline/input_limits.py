"""Limits on what is read, each with its reason; checked before anything is parsed or allocated.

Memory and time below are those of one file on one core: ``gyroscreen benchmark mutations`` measures them.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from .errors import GyroscreenError

#: Largest TOML file [bytes]: 15,000 [[record]] tables.  The parser takes at most 3 s and 350 MB for it.
TOML_BYTES = 2**20
#: Deepest nesting of brackets and braces; a documented value has 3.  The parser calls itself for each.
TOML_DEPTH = 16
#: Most parts of a dotted key; a documented key has 4.  The parser keeps every prefix, 4 GB for a key of 100 kB.
TOML_KEY_PARTS = 8
#: Longest key or number [characters]; messages show keys.  The longest effect parameter has 24.
TOML_KEY_CHARS = 128

#: Largest number of values read from one record file: 268 MB as float64, or eleven minutes of five columns at 10 kHz.
RECORD_VALUES = 2**25
#: Most values per byte of file where the format bounds it; deflate expands by less than this factor.
RECORD_EXPANSION = 1100
#: Longest text of one value of a CSV file [bytes]: a file holds at least its size divided by this many values.
CSV_BYTES_PER_VALUE = 32
#: Longest preamble and header of a text table [bytes]: 2,000 column names.
CSV_HEADER_BYTES = 65_536
#: Most columns of a record file: a hundred channels of metadata beside those of the largest plant.
RECORD_COLUMNS = 1024

#: Memory of a worker of a local run [bytes]; the driver ends one that takes more.
WORKER_BYTES = 2**31
#: Upper bound of what a campaign takes in a run: the program [bytes], bytes for each byte of its values as float64, and columns
#: of float64 for real and imaginary parts of the bins in the band of its fit records.  Measured are 360 MB, 3.9 and 333
#: (``python -m tests.measure.campaign_memory``); text files and a worker of a cluster need some more.
MEMORY_BASE, MEMORY_PER_BYTE, MEMORY_COLUMNS = 500 * 2**20, 5, 400

#: Longest name of a file, and of a path [bytes]: what Linux accepts.
NAME_BYTES, PATH_BYTES = 255, 4095

# An unterminated string reaches to the end, so that the time is proportional to the length; the parser refuses it.
_STRINGS = re.compile(
    r'"""(?:\\(?:.|\Z)|[^\\])*?(?:"{3,5}|\Z)'
    r"|'''.*?(?:'{3,5}|\Z)"
    r'|"(?:\\(?:.|\Z)|[^"\\\n])*+(?:"|\n|\Z)'
    r"|'[^'\n]*+(?:'|\n|\Z)"
    r"|#[^\n]*+",
    re.DOTALL,
)
_BRACKETS = re.compile(r"[\[\]{}]")
_PARTS = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{TOML_KEY_PARTS}}}")
_LONG = re.compile(rf"(?<![\w-])[\w-]{{{TOML_KEY_CHARS + 1}}}")


def check_toml(text: str, where: str, error: type[GyroscreenError]) -> None:
    """Check nesting and keys of a TOML ``text`` before it is parsed; ``where`` names the file in messages.

    Raises
    ------
    GyroscreenError : of the kind ``error``; brackets nested too deeply, or a key that is too long.
    """
    # Strings may contain anything; quoted parts of keys count as one character.
    bare = _STRINGS.sub(lambda found: "" if found[0][0] == "#" else "q" + "\n" * found[0].count("\n"), text)
    depth = 0
    for bracket in _BRACKETS.finditer(bare):
        depth = depth + 1 if bracket[0] in "[{" else max(depth - 1, 0)
        if depth > TOML_DEPTH:
            raise error(
                f"{where}, line {_line(bare, bracket.start())}: brackets are nested too deeply",
                value=f"more than {TOML_DEPTH} levels",
                allowed=f"at most {TOML_DEPTH} levels",
                next_step="remove nested brackets",
            )
    if found := _PARTS.search(bare):
        raise error(
            f"{where}, line {_line(bare, found.start())}: a dotted key has too many parts",
            value=found[0][:40],
            allowed=f"at most {TOML_KEY_PARTS} parts",
            next_step="write the documented keys",
        )
    if found := _LONG.search(bare):
        raise error(
            f"{where}, line {_line(bare, found.start())}: a key or number is too long",
            value=found[0][:40],
            allowed=f"at most {TOML_KEY_CHARS} characters",
            next_step="shorten it, or write text in quotes",
        )


def _line(text: str, at: int) -> int:
    return text.count("\n", 0, at) + 1


def check_path(path: Path, what: str, error: type[GyroscreenError]) -> None:
    """Check that a path can exist.

    Raises
    ------
    GyroscreenError : of the kind ``error``; it is too long or contains a null character.
    """
    name = max((os.fsencode(part) for part in path.parts), key=len, default=b"")
    if len(name) > NAME_BYTES or len(os.fsencode(path)) > PATH_BYTES or b"\0" in os.fsencode(path):
        raise error(
            f"{what} has a path that no file can have",
            value=f"{str(path)[:60]}.. ({len(os.fsencode(path))} bytes)",
            allowed=f"names of at most {NAME_BYTES} and paths of at most {PATH_BYTES} bytes, without null characters",
            next_step="check the path",
        )
