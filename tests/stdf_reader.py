"""A minimal reader of STDF V4, written from the field tables of the specification; it shares no code with the writer."""

import struct
from collections.abc import Iterator
from typing import Any

_COUNTS = "HEAD_NUM U1, SITE_NUM U1, {0}_NUM U2, {0}_CNT U4, {0}_PF C1, {0}_NAM Cn"
#: (REC_TYP, REC_SUB) -> name and fields.
TABLES = {
    (0, 10): ("FAR", "CPU_TYPE U1, STDF_VER U1"),
    (1, 10): (
        "MIR",
        "SETUP_T U4, START_T U4, STAT_NUM U1, MODE_COD C1, RTST_COD C1, PROT_COD C1, BURN_TIM U2, CMOD_COD C1, LOT_ID Cn, "
        "PART_TYP Cn, NODE_NAM Cn, TSTR_TYP Cn, JOB_NAM Cn, JOB_REV Cn, SBLOT_ID Cn, OPER_NAM Cn, EXEC_TYP Cn, EXEC_VER Cn, "
        "TEST_COD Cn, TST_TEMP Cn, USER_TXT Cn, AUX_FILE Cn, PKG_TYP Cn, FAMLY_ID Cn, DATE_COD Cn, FACIL_ID Cn, FLOOR_ID Cn, "
        "PROC_ID Cn, OPER_FRQ Cn, SPEC_NAM Cn, SPEC_VER Cn, FLOW_ID Cn, SETUP_ID Cn, DSGN_REV Cn, ENG_ID Cn, ROM_COD Cn, "
        "SERL_NUM Cn, SUPR_NAM Cn",
    ),
    (1, 20): ("MRR", "FINISH_T U4, DISP_COD C1, USR_DESC Cn, EXC_DESC Cn"),
    (1, 30): ("PCR", "HEAD_NUM U1, SITE_NUM U1, PART_CNT U4, RTST_CNT U4, ABRT_CNT U4, GOOD_CNT U4, FUNC_CNT U4"),
    (1, 40): ("HBR", _COUNTS.format("HBIN")),
    (1, 50): ("SBR", _COUNTS.format("SBIN")),
    (2, 10): ("WIR", "HEAD_NUM U1, SITE_GRP U1, START_T U4, WAFER_ID Cn"),
    (2, 20): (
        "WRR",
        "HEAD_NUM U1, SITE_GRP U1, FINISH_T U4, PART_CNT U4, RTST_CNT U4, ABRT_CNT U4, GOOD_CNT U4, FUNC_CNT U4, WAFER_ID Cn, "
        "FABWF_ID Cn, FRAME_ID Cn, MASK_ID Cn, USR_DESC Cn, EXC_DESC Cn",
    ),
    (2, 30): (
        "WCR",
        "WAFR_SIZ R4, DIE_HT R4, DIE_WID R4, WF_UNITS U1, WF_FLAT C1, CENTER_X I2, CENTER_Y I2, POS_X C1, POS_Y C1",
    ),
    (5, 10): ("PIR", "HEAD_NUM U1, SITE_NUM U1"),
    (5, 20): (
        "PRR",
        "HEAD_NUM U1, SITE_NUM U1, PART_FLG B1, NUM_TEST U2, HARD_BIN U2, SOFT_BIN U2, X_COORD I2, Y_COORD I2, TEST_T U4, "
        "PART_ID Cn, PART_TXT Cn, PART_FIX Bn",
    ),
    (10, 30): (
        "TSR",
        "HEAD_NUM U1, SITE_NUM U1, TEST_TYP C1, TEST_NUM U4, EXEC_CNT U4, FAIL_CNT U4, ALRM_CNT U4, TEST_NAM Cn, SEQ_NAME Cn, "
        "TEST_LBL Cn, OPT_FLAG B1, TEST_TIM R4, TEST_MIN R4, TEST_MAX R4, TST_SUMS R4, TST_SQRS R4",
    ),
    (15, 10): (
        "PTR",
        "TEST_NUM U4, HEAD_NUM U1, SITE_NUM U1, TEST_FLG B1, PARM_FLG B1, RESULT R4, TEST_TXT Cn, ALARM_ID Cn, OPT_FLAG B1, "
        "RES_SCAL I1, LLM_SCAL I1, HLM_SCAL I1, LO_LIMIT R4, HI_LIMIT R4, UNITS Cn, C_RESFMT Cn, C_LLMFMT Cn, C_HLMFMT Cn, "
        "LO_SPEC R4, HI_SPEC R4",
    ),
}  # fmt: skip
_SIMPLE = {"U1": "B", "U2": "H", "U4": "I", "I1": "b", "I2": "h", "I4": "i", "R4": "f", "R8": "d", "B1": "B"}


def records(data: bytes) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and fields of each record; fields left out at the end are absent."""
    # CPU_TYPE is the first byte after the header of the first record: 1 is a Sun, 2 an IBM PC.
    order = {1: ">", 2: "<"}[data[4]]
    place = 0
    while place < len(data):
        length, kind, sub = struct.unpack_from(f"{order}HBB", data, place)
        body = data[place + 4 : place + 4 + length]
        if len(body) != length:
            raise ValueError("the file ends within a record")
        name, table = TABLES[kind, sub]
        yield name, fields(body, table, order)
        place += 4 + length


def fields(body: bytes, table: str, order: str) -> dict[str, Any]:
    """The fields of a record in the order of its table."""
    found: dict[str, Any] = {}
    place = 0
    for field in table.split(", "):
        if place == len(body):
            return found
        name, code = field.split()
        if code in ("Cn", "Bn"):
            size = body[place]
            value: Any = body[place + 1 : place + 1 + size]
            if len(value) != size:
                raise ValueError(f"{name} is cut")
            place += 1 + size
            value = value.decode("ascii") if code == "Cn" else value
        elif code == "C1":
            value, place = chr(body[place]), place + 1
        else:
            size = struct.calcsize(order + _SIMPLE[code])
            (value,) = struct.unpack_from(order + _SIMPLE[code], body, place)
            place += size
        found[name] = value
    if place != len(body):
        raise ValueError(f"{len(body) - place} bytes after the last field")
    return found
