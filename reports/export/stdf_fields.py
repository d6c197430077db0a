"""Records of STDF V4 as bytes, little-endian (CPU_TYPE 2).

A record is REC_LEN U*2, REC_TYP U*1, REC_SUB U*1 and its fields:

| code | bytes |
|---|---|
| U*1, U*2, U*4; I*1, I*2; R*4 | unsigned, signed integers; IEEE single |
| B*1 | eight flags |
| C*1 | one character |
| C*n | a length byte, and up to 255 characters |

A field at the end of a record may be left out where it has no data.

Source: Teradyne, Standard Test Data Format (STDF) Specification, Version 4: "STDF Record Structure", "Data Type Codes and
Representation", and the field table of each record.
"""

from __future__ import annotations

import math
import struct

#: Longest text of a C*n field [bytes].
TEXT_BYTES = 255
NO_COORDINATE, NO_COUNT, NO_BIN = -32768, 2**32 - 1, 65535
#: Largest number of an R*4 field: (2 - 2^-23) 2^127.
LARGEST = (2.0 - 2.0**-23) * 2.0**127
#: HEAD_NUM of a record that summarises all sites.
ALL_SITES = 255


def text(value: str) -> bytes:
    """A C*n field: ASCII, other characters as "?"; longer texts are cut to ``TEXT_BYTES``."""
    data = value.encode("ascii", "replace")[:TEXT_BYTES]
    return bytes([len(data)]) + data


def is_cut(value: str) -> bool:
    """Whether :func:`text` cuts ``value``."""
    return len(value) > TEXT_BYTES


def record(kind: tuple[int, int], *fields: bytes) -> bytes:
    """A record with its header; ``kind``: REC_TYP, REC_SUB."""
    body = b"".join(fields)
    return struct.pack("<HBB", len(body), *kind) + body


def far() -> bytes:
    """File Attributes Record: the byte order, and version 4."""
    return record((0, 10), bytes([2, 4]))


def mir(setup_s: int, lot: str, part: str, job: str, executive: str, version: str, remark: str) -> bytes:
    """Master Information Record; ``setup_s``: when the run began [s since 1970], also START_T."""
    head = struct.pack("<IIBcccHc", setup_s, setup_s, 1, b" ", b" ", b" ", 65535, b" ")
    # LOT_ID PART_TYP NODE_NAM TSTR_TYP JOB_NAM JOB_REV SBLOT_ID OPER_NAM EXEC_TYP EXEC_VER TEST_COD TST_TEMP USER_TXT
    texts = (lot, part, executive, executive, job, "", "", "", executive, version, "", "", remark)
    return record((1, 10), head, *map(text, texts))


def mrr(finish_s: int) -> bytes:
    """Master Results Record; ``finish_s``: the end of the run [s since 1970]."""
    return record((1, 20), struct.pack("<Ic", finish_s, b" "))


def pcr(parts: int, good: int) -> bytes:
    """Part Count Record of all sites."""
    return record((1, 30), struct.pack("<BBIIIII", ALL_SITES, 1, parts, NO_COUNT, NO_COUNT, good, NO_COUNT))


def bin_record(hard: bool, number: int, parts: int, passing: str, name: str) -> bytes:
    """Hardware or Software Bin Record of all sites; ``passing``: "P", "F" or " "."""
    head = struct.pack("<BBHIc", ALL_SITES, 1, number, parts, passing.encode("ascii"))
    return record((1, 40) if hard else (1, 50), head, text(name))


def wcr(die_width_mm: float, die_height_mm: float) -> bytes:
    """Wafer Configuration Record: pitch [mm], X to the right, Y up, the wafer's centre at die (0, 0)."""
    return record((2, 30), struct.pack("<fffBchhcc", 0.0, die_height_mm, die_width_mm, 3, b" ", 0, 0, b"R", b"U"))


def wir(start_s: int, wafer: str) -> bytes:
    """Wafer Information Record."""
    return record((2, 10), struct.pack("<BBI", 1, 255, start_s), text(wafer))


def wrr(finish_s: int, parts: int, good: int, wafer: str) -> bytes:
    """Wafer Results Record."""
    return record(
        (2, 20), struct.pack("<BBIIIIII", 1, 255, finish_s, parts, NO_COUNT, NO_COUNT, good, NO_COUNT), text(wafer)
    )


def pir() -> bytes:
    """Part Information Record."""
    return record((5, 10), bytes([1, 1]))


def prr(flags: int, tests: int, hard: int, soft: int, x: int, y: int, part: str, remark: str) -> bytes:
    """Part Results Record; ``x``, ``y``: die, ``NO_COORDINATE`` where unknown."""
    head = struct.pack("<BBBHHHhhI", 1, 1, flags, tests, hard, soft, x, y, 0)
    return record((5, 20), head, text(part), text(remark) if remark else b"")


def ptr(
    number: int, flags: int, parametric: int, result: float, name: str, low: float, high: float, unit: str
) -> bytes:
    """Parametric Test Record with its default data; a limit that is not finite is none.

    Later records of the test end with RESULT: what follows is the default of its test number.
    """
    # Bit 1 is reserved and 1; 2, 3: no specification limits; 6, 7: no test limits.
    options = 0b0000_1110 | (0 if math.isfinite(low) else 0x40) | (0 if math.isfinite(high) else 0x80)
    limits = [limit if math.isfinite(limit) else 0.0 for limit in (low, high)]
    head = struct.pack("<IBBBBf", number, 1, 1, flags, parametric, result)
    return record((15, 10), head, text(name), text(""), struct.pack("<Bbbbff", options, 0, 0, 0, *limits), text(unit))


def tsr(
    number: int, executed: int, failed: int, name: str, least: float, most: float, total: float, squares: float
) -> bytes:
    """Test Synopsis Record of all sites; ``least`` .. ``squares``: of the results, nan for no result."""
    values = (least, most, total, squares)
    known = [math.isfinite(one) and abs(one) <= LARGEST for one in values]
    # Bit 2: no test time; 3, 6, 7 are reserved and 1; 0, 1, 4, 5: no minimum, maximum, sum, sum of squares.
    options = 0b1100_1100 | sum(0 if one else 1 << bit for one, bit in zip(known, (0, 1, 4, 5)))
    stored = (0.0, *(value if one else 0.0 for value, one in zip(values, known)))
    head = struct.pack("<BBcIIII", ALL_SITES, 1, b"P", number, executed, failed, NO_COUNT)
    return record((10, 30), head, text(name), text(""), text(""), struct.pack("<B5f", options, *stored))
