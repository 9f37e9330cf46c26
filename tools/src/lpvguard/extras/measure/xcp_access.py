"""Describe the access to the slave of lpvguard/xcp.h in ASAP2: IF_DATA XCPplus for XCP on CAN.

The block has the grammar of the standard (ASAM MCD-1 XCP, AML of protocol layer, DAQ and CAN), which tools
know. Sizes and the event's name come from the core's header.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ...base.errors import InputError

EXTENDED = 0x80000000
"""Flag of an identifier of 29 bits, in the core and in ASAP2."""
OPTIONAL_COMMANDS = (
    "GET_COMM_MODE_INFO",
    "GET_ID",
    "SET_MTA",
    "UPLOAD",
    "SHORT_UPLOAD",
    "CLEAR_DAQ_LIST",
    "SET_DAQ_PTR",
    "WRITE_DAQ",
    "SET_DAQ_LIST_MODE",
    "GET_DAQ_LIST_MODE",
    "START_STOP_DAQ_LIST",
    "START_STOP_SYNCH",
    "GET_DAQ_PROCESSOR_INFO",
    "GET_DAQ_RESOLUTION_INFO",
    "GET_DAQ_EVENT_INFO",
    "FREE_DAQ",
    "ALLOC_DAQ",
    "ALLOC_ODT",
    "ALLOC_ODT_ENTRY",
)
"""Optional commands of the slave; CONNECT, DISCONNECT, GET_STATUS and SYNCH are mandatory."""
_TIMEOUTS_MS = (1000, 200, 0, 0, 0, 0, 0)
"""Timeouts T1 to T7 for an answer and a checksum; programming is not supported."""
_BYTES_OF_FRAME = 8


@dataclass(frozen=True)
class XcpAccess:
    """Identifiers for XCP on CAN.

    Attributes
    ----------
    commands, answers : int, with EXTENDED if they have 29 bits
    """

    commands: int
    answers: int

    @classmethod
    def parse(cls, text: str) -> XcpAccess:
        """Parse `COMMANDS:ANSWERS`, written as in C (0x98EF27F9:0x98EFF927). Raises InputError."""
        want = (
            "COMMANDS:ANSWERS, two identifiers that differ, with 0x80000000 set where they have 29 bits, as "
            "0x98EF27F9:0x98EFF927"
        )
        try:
            commands, answers = (int(word, 0) for word in text.split(":"))
        except ValueError:
            raise InputError("--xcp", "", repr(text), want) from None
        for one in (commands, answers):
            if not (0 <= one < 0x800 or EXTENDED <= one < EXTENDED + (1 << 29)):
                raise InputError("--xcp", "", f"{one:#x} is not an identifier", want)
        if commands == answers:
            raise InputError("--xcp", "", "the identifiers are equal", want)
        return cls(commands, answers)


def if_data(access: XcpAccess, period_us: int, big_endian: bool, include: Path) -> list[str]:
    """Return the lines of the block; a step lasts ``period_us``, and ``include`` has the core's headers.

    Raises InputError if the headers have no XCP slave.
    """
    header = include / "xcp.h"
    entry_bytes = int(_defined(header, "ODT_ENTRIES_MAX", r"(\d+)U"))
    event = _defined(header, "EVENT_NAME", r'"(\w+)"')
    cycle, unit = period_us, 3  # the unit of 1 us
    while cycle > 255:
        cycle, unit = cycle // 10, unit + 1
    return [
        "/begin IF_DATA XCPplus 0x0101",
        "/begin PROTOCOL_LAYER",
        f"0x0101 {' '.join(map(str, _TIMEOUTS_MS))} {_BYTES_OF_FRAME} {_BYTES_OF_FRAME}",
        "BYTE_ORDER_MSB_FIRST" if big_endian else "BYTE_ORDER_MSB_LAST",
        "ADDRESS_GRANULARITY_BYTE",
        *(f"OPTIONAL_CMD {name}" for name in OPTIONAL_COMMANDS),
        "/end PROTOCOL_LAYER",
        "/begin DAQ",
        "DYNAMIC 1 1 0",
        "OPTIMISATION_TYPE_DEFAULT ADDRESS_EXTENSION_FREE IDENTIFICATION_FIELD_TYPE_ABSOLUTE",
        f"GRANULARITY_ODT_ENTRY_SIZE_DAQ_BYTE {entry_bytes} NO_OVERLOAD_INDICATION",
        "PRESCALER_SUPPORTED",
        f'/begin EVENT "{event}" "{event}" 0 DAQ 1 {cycle} {unit} 0',
        "/end EVENT",
        "/end DAQ",
        "/begin XCP_ON_CAN",
        "0x0101",
        f"CAN_ID_MASTER 0x{access.commands:08X}",
        f"CAN_ID_SLAVE 0x{access.answers:08X}",
        "/end XCP_ON_CAN",
        "/end IF_DATA",
    ]


def _defined(header: Path, name: str, pattern: str) -> str:
    text = header.read_text(encoding="utf-8") if header.is_file() else ""
    match = re.search(rf"^#define LPVG_XCP_{name} {pattern}", text, re.MULTILINE)
    if not match:
        raise InputError(header, f"LPVG_XCP_{name}", "not there", "the headers of a core with an XCP slave")
    return match[1]
