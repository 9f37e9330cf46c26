"""Checksums of cars' own buses, by name: the data that they cover, their places, and their C code.

A frame has the identifier I and L bytes. "Others" are the bytes that do not hold the checksum. The sources
are the public databases and packers of commaai/opendbc, and AUTOSAR_PRS_E2EProtocol.

    toyota               bytes of I + L + others, modulo 256; the last byte
    honda                8 (11 for 29-bit I) - (all half bytes of I and of the frame but the checksum),
                         modulo 16
    subaru, tesla        low and second byte of I + others, modulo 256
    chrysler             CRC-8, polynomial 0x1D, over the others; register starts at 0xFF, xor-out 0xFF
                         (SAE J1850); the last byte
    volkswagen_xor       exclusive or of the others
    nissan               CRC-8, polynomial 0x1D, over the others; register starts at 0, xor-out 0xFF
    ford_speed           0xFF - (bytes 0 and 1 + bits 6 and 7 of byte 2 + bits 2 to 5 of byte 2), modulo 256;
                         byte 3, counter in those 4 bits (BrakeSysFeatures)
    ford_yaw_rate        0xFF - (bytes 0 to 3 and 5 + bits 6 and 7 of byte 6 + bits 4 and 5 of byte 6),
                         modulo 256; byte 4, counter in byte 5 (Yaw_Data_FD1)
    hyundai_sum          others, modulo 256
    hyundai_sum_before   bytes before the checksum, modulo 256
    hyundai_nibbles      -(all half bytes but the checksum), modulo 16
    hyundai_crc8         CRC-8, polynomial 0x1D, over the others; register starts at 0x22, xor-out 0xDF
    hyundai_canfd        CRC-16, polynomial 0x1021, over bytes 2 on, I low, I high; xor-out by length; bytes 0
                         and 1, low byte first
    autosar_p01, _p11    CRC-8, polynomial 0x1D, over data id low, data id high (mode BOTH), others; byte 0,
                         counter 0 to 14 in the low half of byte 1
    autosar_p02, _p22    CRC-8, polynomial 0x2F, over others and the list's data id at the counter; register
                         starts at 0xFF, xor-out 0xFF; byte 0, counter 0 to 15 in the low half of byte 1
    autosar_p05          CRC-16, polynomial 0x1021, over others, data id low, data id high; register starts at
                         0xFFFF; bytes 0 and 1, low byte first; counter 0 to 255 in byte 2
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Place:
    """Bits of a frame, with the fields of a signal of a cantools database."""

    start: int
    length: int
    byte_order: str = "little_endian"


@dataclass(frozen=True)
class Protection:
    """Definition of a checksum.

    ``bits`` is its width. ``checksum`` and ``counter`` are the places by definition. A negative start counts
    from the end of the frame. With None, the database states the place. ``counters`` is the number of values
    of the counter; None means all values of its bits. ``data_ids`` is the number of data ids. ``lengths``
    holds the allowed frame lengths; an empty list allows every length.
    """

    function: str
    bits: int
    checksum: Place | None = None
    counter: Place | None = None
    counters: int | None = None
    data_ids: int = 0
    lengths: tuple[int, ...] = ()


_COUNTER = Place(8, 4)
_WORD = Place(0, 16)
_E2E_1 = Protection("check_p11", 8, Place(0, 8), _COUNTER, 15, 1)
_E2E_2 = Protection("check_p22", 8, Place(0, 8), _COUNTER, 16, 16)
PROTECTIONS = {
    "toyota": Protection("check_toyota", 8, Place(-8, 8)),
    "honda": Protection("check_honda", 4),
    "subaru": Protection("check_sum_id", 8),
    "tesla": Protection("check_sum_id", 8),
    "chrysler": Protection("check_j1850", 8, Place(-8, 8)),
    "volkswagen_xor": Protection("check_xor", 8),
    "nissan": Protection("check_crc8_zero", 8),
    "ford_speed": Protection("check_ford_speed", 8, Place(24, 8), Place(18, 4), lengths=(8,)),
    "ford_yaw_rate": Protection("check_ford_yaw_rate", 8, Place(32, 8), Place(40, 8), lengths=(8,)),
    "hyundai_sum": Protection("check_sum", 8),
    "hyundai_sum_before": Protection("check_sum_before", 8),
    "hyundai_nibbles": Protection("check_nibbles", 4),
    "hyundai_crc8": Protection("check_crc8", 8),
    "hyundai_canfd": Protection("check_canfd", 16, _WORD, lengths=(8, 16, 24, 32)),
    "autosar_p01": _E2E_1,
    "autosar_p11": _E2E_1,
    "autosar_p02": _E2E_2,
    "autosar_p22": _E2E_2,
    "autosar_p05": Protection("check_p05", 16, _WORD, Place(16, 8), 256, 1),
}
"""Checksum by its name in a project file."""

_CRC8 = """\
static uint32_t crc8(uint32_t crc, uint32_t polynomial, uint32_t byte)
{
    uint32_t bit;
    crc ^= byte;
    for (bit = 0u; bit < 8u; ++bit) {
        crc = ((crc << 1) ^ (((crc & 0x80u) != 0u) ? polynomial : 0u)) & 0xFFu;
    }
    return crc;
}
"""
_CRC16 = """\
static uint32_t crc16(uint32_t crc, uint32_t byte)
{
    uint32_t bit;
    crc ^= byte << 8;
    for (bit = 0u; bit < 8u; ++bit) {
        crc = ((crc << 1) ^ (((crc & 0x8000u) != 0u) ? 0x1021u : 0u)) & 0xFFFFu;
    }
    return crc;
}
"""
_OTHERS = "for (i = 0u; i < frame->length; ++i) {\n        if (i != frame->at) {\n"
_BODIES = {
    "check_toyota": (
        "",
        "uint32_t value = frame->length;\n    uint32_t left = frame->id;",
        "while (left != 0u) {\n        value += left & 0xFFu;\n        left >>= 8;\n    }\n    "
        + _OTHERS
        + "            value += frame->data[i];\n        }\n    }\n    return value & 0xFFu;",
    ),
    "check_sum": (
        "",
        "uint32_t value = 0u;",
        _OTHERS + "            value += frame->data[i];\n        }\n    }\n    return value & 0xFFu;",
    ),
    "check_sum_before": (
        "",
        "uint32_t value = 0u;",
        "for (i = 0u; i < frame->at; ++i) {\n        value += frame->data[i];\n    }\n"
        "    return value & 0xFFu;",
    ),
    "check_nibbles": (
        "",
        "uint32_t value = 0u;",
        "for (i = 0u; i < frame->length; ++i) {\n"
        "        const uint32_t byte = frame->data[i] & ((i == frame->at) ? frame->keep : 0xFFu);\n"
        "        value += (byte >> 4) + (byte & 0xFu);\n    }\n    return (0u - value) & 0xFu;",
    ),
    "check_honda": (
        "",
        "uint32_t value = 0u;\n    uint32_t left = frame->id;",
        "while (left != 0u) {\n        value += left & 0xFu;\n        left >>= 4;\n    }\n"
        "    for (i = 0u; i < frame->length; ++i) {\n"
        "        const uint32_t byte = frame->data[i] & ((i == frame->at) ? frame->keep : 0xFFu);\n"
        "        value += (byte >> 4) + (byte & 0xFu);\n    }\n"
        "    return (((frame->id > 0x7FFu) ? 11u : 8u) - value) & 0xFu;",
    ),
    "check_sum_id": (
        "",
        "uint32_t value = (frame->id & 0xFFu) + ((frame->id >> 8) & 0xFFu);",
        _OTHERS + "            value += frame->data[i];\n        }\n    }\n    return value & 0xFFu;",
    ),
    "check_j1850": (
        _CRC8,
        "uint32_t value = 0xFFu;",
        _OTHERS
        + "            value = crc8(value, 0x1Du, frame->data[i]);\n        }\n    }\n"
        + "    return value ^ 0xFFu;",
    ),
    "check_xor": (
        "",
        "uint32_t value = 0u;",
        _OTHERS + "            value ^= frame->data[i];\n        }\n    }\n    return value;",
    ),
    "check_crc8": (
        _CRC8,
        "uint32_t value = 0x22u;",
        _OTHERS
        + "            value = crc8(value, 0x1Du, frame->data[i]);\n        }\n    }\n"
        + "    return value ^ 0xDFu;",
    ),
    "check_crc8_zero": (
        _CRC8,
        "uint32_t value = 0u;",
        _OTHERS
        + "            value = crc8(value, 0x1Du, frame->data[i]);\n        }\n    }\n"
        + "    return value ^ 0xFFu;",
    ),
    "check_ford_speed": (
        "",
        "const uint32_t flags = frame->data[2];\n    uint32_t value = (flags >> 6) + ((flags >> 2) & 0xFu);",
        "for (i = 0u; i < 2u; ++i) {\n        value += frame->data[i];\n    }\n"
        "    return (0xFFu - value) & 0xFFu;",
    ),
    "check_ford_yaw_rate": (
        "",
        "const uint32_t flags = frame->data[6];\n    uint32_t value = (flags >> 6) + ((flags >> 4) & 0x3u);",
        "for (i = 0u; i < 6u; ++i) {\n        value += (i != frame->at) ? frame->data[i] : 0u;\n    }\n"
        "    return (0xFFu - value) & 0xFFu;",
    ),
    "check_canfd": (
        _CRC16,
        "uint32_t value = 0u;",
        "for (i = 2u; i < frame->length; ++i) {\n        value = crc16(value, frame->data[i]);\n    }\n"
        "    value = crc16(crc16(value, frame->id & 0xFFu), (frame->id >> 8) & 0xFFu);\n"
        "    switch (frame->length) {\n    case 8u:\n        return value ^ 0x5F29u;\n"
        "    case 16u:\n        return value ^ 0x041Du;\n    case 24u:\n        return value ^ 0x819Du;\n"
        "    default:\n        return value ^ 0x9F5Bu;\n    }",
    ),
    "check_p11": (
        _CRC8,
        "uint32_t value = crc8(crc8(0u, 0x1Du, frame->data_id & 0xFFu), 0x1Du, frame->data_id >> 8);",
        _OTHERS
        + "            value = crc8(value, 0x1Du, frame->data[i]);\n        }\n    }\n    return value;",
    ),
    "check_p22": (
        _CRC8,
        "uint32_t value = 0xFFu;",
        _OTHERS
        + "            value = crc8(value, 0x2Fu, frame->data[i]);\n        }\n    }\n"
        + "    return crc8(value, 0x2Fu, frame->data_id) ^ 0xFFu;",
    ),
    "check_p05": (
        _CRC16,
        "uint32_t value = 0xFFFFu;",
        "for (i = 0u; i < frame->length; ++i) {\n        if ((i != frame->at) && (i != (frame->at + 1u))) {\n"
        "            value = crc16(value, frame->data[i]);\n        }\n    }\n"
        "    return crc16(crc16(value, frame->data_id & 0xFFu), frame->data_id >> 8);",
    ),
}
"""By C function: the functions that it calls, its variables, and its statements."""


def check_source(names: set[str]) -> str:
    """C functions that compute the checksums ``names`` (keys of PROTECTIONS); empty without names."""
    functions = sorted({PROTECTIONS[name].function for name in names})
    if not functions:
        return ""
    called = sorted({_BODIES[function][0] for function in functions} - {""})
    parts = [
        """
/* A frame, the byte at which its checksum begins, the bits of that byte that are not its, and the data id. */
typedef struct checked_frame_t {
    uint32_t id;
    const uint8_t* data;
    uint32_t length;
    uint32_t at;
    uint32_t keep;
    uint32_t data_id;
} checked_frame_t;

""",
        "\n".join(called),
    ]
    for function in functions:
        _, variables, statements = _BODIES[function]
        parts.append(
            f"\nstatic uint32_t {function}(const checked_frame_t* frame)\n{{\n"
            f"    {variables}\n    uint32_t i;\n    {statements}\n}}\n"
        )
    return "".join(parts)
