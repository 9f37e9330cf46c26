"""Damaged logs whose readers would not end, or would read what is not the log's."""

import gzip

import asammdf
import can
import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.damaged import require_sound_blocks
from lpvguard.can.logs import read_log


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize("suffix", [".blf", ".blf.gz"])
def test_a_blf_log_whose_reader_would_stay_at_an_object_without_bytes_is_refused(suffix, version, tmp_path):
    """Found by fuzz/foreign_input.py: python-can went on by the object's size, which was 0."""
    path = tmp_path / "drive.blf"
    with can.BLFWriter(path, compression_level=0) as writer:
        for k in range(3):
            writer.on_message_received(can.Message(timestamp=1.0 + k, arbitration_id=0x123, data=b"12345678"))
    content = bytearray(path.read_bytes())
    assert len(read_log(path).id) == 3
    second = [at for at in range(len(content)) if content.startswith(b"LOBJ", at)][
        2
    ]  # the first one is the container
    content[second + 6 : second + 12] = bytes([version, 0, 0, 0, 0, 0])
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(gzip.compress(content) if suffix.endswith("gz") else content)
    with pytest.raises(InputError, match=r"cannot be read \(ValueError: an object without bytes\)"):
        read_log(path)


def links(version: str) -> tuple[int, int, int]:
    """Where an MDF file has its first group's address, a block the next one's, and their bytes."""
    return (88, 24, 8) if version[0] == "4" else (68, 4, 4)


def first_block(content: bytes, version: str, depth: int) -> int:
    """Address of the first group (0) of an MDF file, of that one's first channel group (1) or channel (2)."""
    first, following, width = links(version)
    at = int.from_bytes(content[first : first + width], "little")
    for _ in range(depth):
        at = int.from_bytes(content[at + following + width : at + following + 2 * width], "little")
    return at


@pytest.mark.parametrize(
    ("level", "version"),
    [(level, version) for level in ("groups", "channel groups", "channels") for version in ("3.30", "4.10")]
    + [("data", "4.10")],
)
def test_an_mdf_file_whose_list_comes_back_to_its_beginning_is_refused(level, version, tmp_path):
    """Found by fuzz/foreign_input.py: asammdf follows the next block's address and never ends."""
    path = tmp_path / ("drive.mf4" if version[0] == "4" else "drive.mdf")
    t = np.arange(3.0)
    with asammdf.MDF(version=version) as mdf:
        mdf.append([asammdf.Signal(samples=t, timestamps=t, name="x")])
        mdf.save(path, compression=0)
    content = bytearray(path.read_bytes())
    _, following, width = links(version)
    if level == "data":  # a list of blocks of data that has itself for the next
        at = len(content)
        content += b"##DL" + bytes(12) + (1).to_bytes(8, "little") + at.to_bytes(8, "little") + bytes(24)
        group = first_block(content, version, 0)
        content[group + following + 2 * width : group + following + 3 * width] = at.to_bytes(width, "little")
    else:
        at = first_block(content, version, ["groups", "channel groups", "channels"].index(level))
    content[at + following : at + following + width] = at.to_bytes(width, "little")
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"cannot be read \(ValueError: a list of blocks without an end\)"):
        read_log(path)


def first_channel(content: bytes, version: str) -> int:
    """Address of the second channel of an MDF file's first group: the one behind its time."""
    _, following, width = links(version)
    at = first_block(content, version, 2) + following
    return int.from_bytes(content[at : at + width], "little")


MDF_4_FIELDS = 24 + 8 * 8  # behind the links of a channel that asammdf writes
BEYOND = {
    "byte": ("4.10", MDF_4_FIELDS + 4, 4, 9),
    "bit": ("4.10", MDF_4_FIELDS + 3, 1, 1),
    "bits": ("4.10", MDF_4_FIELDS + 8, 4, 65),
    "bit of MDF 3": ("3.30", 186, 2, 65),
    "bits of MDF 3": ("3.30", 188, 2, 65),
    "byte of MDF 3": ("3.30", 226, 2, 1),
}


@pytest.mark.parametrize("field", BEYOND)
def test_an_mdf_channel_beyond_its_record_is_refused(field, tmp_path):
    """Found by fuzz/foreign_input.py: asammdf read what lay behind the record, or ended the process."""
    version, at, width, value = BEYOND[field]
    path = tmp_path / "drive.mf4"
    t = np.arange(3.0)
    with asammdf.MDF(version=version) as mdf:
        mdf.append([asammdf.Signal(samples=t + 1, timestamps=t, name="x")])
        path = mdf.save(path, compression=0)
    assert read_log(path).series["x"].value.tolist() == [1.0, 2.0, 3.0]
    content = bytearray(path.read_bytes())
    at += first_channel(content, version)
    content[at : at + width] = value.to_bytes(width, "little")
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"cannot be read \(ValueError: a channel beyond its record\)"):
        read_log(path)


@pytest.mark.parametrize("kind", [3, 6])
def test_a_virtual_mdf_channel_has_no_place_in_the_record(kind, tmp_path):
    t = np.arange(3.0)
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append([asammdf.Signal(samples=t + 1, timestamps=t, name="x")])
        path = mdf.save(tmp_path / "drive.mf4", compression=0)
    content = bytearray(path.read_bytes())
    fields = first_channel(content, "4.10") + MDF_4_FIELDS
    content[fields], content[fields + 4] = kind, 9
    path.write_bytes(content)
    require_sound_blocks(path)


def test_an_mdf_part_of_a_bus_frame_an_array_and_an_invalidation_bit_stay_within_their_record(tmp_path):
    path, t = tmp_path / "raw.mf4", np.arange(3.0)
    with can.Logger(path) as log:
        for k in range(3):
            log.on_message_received(can.Message(timestamp=1.0 + k, arbitration_id=0x123, data=b"12345678"))
    content = bytearray(path.read_bytes())
    frame = first_channel(content, "4.10")
    part = int.from_bytes(content[frame + 32 : frame + 40], "little")
    content[part + MDF_4_FIELDS + 6] = 1  # 65,536 bytes further
    path.write_bytes(content)
    with pytest.raises(InputError, match="a channel beyond its record"):
        read_log(path)

    pairs = np.zeros(3, [("y", "<f8", (2,))])
    signals = {
        "array": (asammdf.Signal(samples=pairs, timestamps=t, name="y"), "a channel beyond its record"),
        "bit": (
            asammdf.Signal(samples=t, timestamps=t, name="y", invalidation_bits=t > 1),
            "an invalidation bit beyond its record",
        ),
    }
    for name, (signal, what) in signals.items():
        with asammdf.MDF(version="4.10") as mdf:
            mdf.append([signal])
            path = mdf.save(tmp_path / f"{name}.mf4", compression=0)
        read_log(path)
        content = bytearray(path.read_bytes())
        channel = first_channel(content, "4.10")
        at = channel + MDF_4_FIELDS + 16  # the bit's place
        if name == "array":
            array = int.from_bytes(content[channel + 32 : channel + 40], "little")
            assert content[array : array + 4] == b"##CA"
            at = (
                array + 24 + 8 * int.from_bytes(content[array + 16 : array + 24], "little") + 16
            )  # its length
        content[at] = 9
        path.write_bytes(content)
        with pytest.raises(InputError, match=what):
            read_log(path)
