"""The C text of cars' checksums on known frames: public vectors, and frames by the definition."""

import ctypes
import os
import subprocess

import pytest

from lpvguard.can.protection import PROTECTIONS, check_source

HONDA = [(0x33D, f"41050000{c}0", 4, 11 - c) for c in range(4)] + [
    (0x33DA, f"41050000{c}0", 4, 4 - c) for c in range(4)
]
"""commaai/opendbc, test_honda_checksum: LKAS_HUD and LKAS_HUD_A by counter."""
LWI_01 = ("6b00bd0000000000", "ee010a0000000000", "d802a90000000000", "0303bea212000000", "7b04312003000000")
"""The same, test_volkswagen_mqb_crc_lwi_01: the list of data ids is 0x86 throughout."""
FRAMES = {
    "honda": [(i, data, at, 0xF0, 0, value) for i, data, at, value in HONDA],
    "chrysler": [(0x123, "31323334353637383900", 9, 0, 0, 0x4B)],  # the CRC catalogue's check of SAE-J1850
    "autosar_p02": [(0x86, data, 0, 0, 0x86, int(data[:2], 16)) for data in LWI_01],
    "tesla": [(0x129, "0102030405060700", 7, 0, 0, 0x01 + 0x29 + 28)],
    "subaru": [(0x11F, "00f0f0f000000000", 0, 0, 0, (0x01 + 0x1F + 3 * 0xF0) % 256)],
    "nissan": [(0x169, "31323334353637383900", 9, 0, 0, 0x37 ^ 0xFF)],  # the catalogue's SAE-J1850-ZERO
    # By the definition in commaai/opendbc (its safety mode of Ford): 0xFF - (0x12 + 0x34 + 3 + 5).
    "ford_speed": [(0x415, "1234d600aabbccdd", 3, 0, 0, 0xB1)],
    "ford_yaw_rate": [(0x91, "01020304002ab0ff", 4, 0, 0, 0xFF - (10 + 0x2A + 2 + 3))],
    "volkswagen_xor": [(0xC2, "0102040810204000", 7, 0, 0, 0x7F)],
}
"""By name: identifier, data, byte of the checksum, bits of that byte that are not its, data id, checksum."""


@pytest.mark.skipif(os.name == "nt", reason="needs a C compiler as on Unix")
@pytest.mark.parametrize("name", FRAMES)
def test_a_checksum_is_that_of_known_frames(tmp_path, name):
    function = PROTECTIONS[name].function
    source = tmp_path / "check.c"
    source.write_text(
        "#include <stdint.h>\n"
        + check_source({name})
        + "uint32_t check(uint32_t id, const uint8_t* data, uint32_t length, uint32_t at, uint32_t keep,\n"
        "               uint32_t data_id)\n{\n"
        "    const checked_frame_t frame = {id, data, length, at, keep, data_id};\n"
        f"    return {function}(&frame);\n}}\n"
    )
    library = tmp_path / "check.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    check = ctypes.CDLL(str(library)).check
    check.restype = ctypes.c_uint32
    for identifier, text, at, keep, data_id, value in FRAMES[name]:
        data = bytes.fromhex(text)
        assert check(identifier, data, len(data), at, keep, data_id) == value, text
        changed = bytes([data[0] ^ (0 if at == 0 else 4), data[1] ^ 1, *data[2:]])
        assert check(identifier, changed, len(data), at, keep, data_id) != value
