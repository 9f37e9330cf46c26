"""Traces of PCAN, CANHacker and python-can have the frames that were written, or are refused by line."""

import can
import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.logs import EXTENDED, Frames, read_log

MESSAGES = [
    can.Message(1000.0, 0x123, False, data=bytes(range(8)), channel=1),
    can.Message(1000.003, 0x18FECA0E, True, data=b"\xff\x00", channel=1),
    can.Message(1000.02, 0x7FF, False, is_remote_frame=True, dlc=8, channel=1),
    can.Message(1000.023, 0x10, False, data=b"", channel=1),
]
WITH_HEAD = ";$STARTTIME=43008.5\n; comment\n"
HAND = {
    "pcan 1.0": """; Start time: 11.09.2002
 1)   1841.2 0123 2 0A 0B
 2)   1842 18FECA0E 1 FF
 3)   1843 FFFFFFFF 4 00 00 00 04 BUSLIGHT
 4)   1844 0100 3 RTR
""",
    "pcan 1.1": f""";$FILEVERSION=1.1
{WITH_HEAD} 1) 1841.2 Rx 0123 2 0A 0B
 2) 1842.0 Tx 18FECA0E 1 FF
 3) 1843.0 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY
 4) 1844.0 Rx 0100 3 RTR
""",
    "pcan 1.2": f""";$FILEVERSION=1.2
{WITH_HEAD} 1) 1841.2 1 Rx 0123 2 0A 0B
 2) 1842.0 1 Tx 18FECA0E 1 FF
 3) 1843.0 1 Error 0008 4 00 19 08 08
 4) 1844.0 1 Rx 0100 3 RTR
""",
    "pcan 1.3": f""";$FILEVERSION=1.3
{WITH_HEAD} 1) 1841.2 1 Rx 0123 - 2 0A 0B
 2) 1842.0 1 Tx 18FECA0E - 1 FF
 3) 1843.0 1 Error 0008 - 4 00 19 08 08
 4) 1844.0 1 Rx 0100 - 3 RTR
""",
    "pcan 2.0": f""";$FILEVERSION=2.0
;$COLUMNS=N,O,T,I,d,l,D
{WITH_HEAD} 1 1841.200 DT 0123 Rx 2 0A 0B
 2 1842.000 FB 18FECA0E Tx 1 FF
 3 1843.000 ST Rx 00 00 00 08
 4 1844.000 RR 0100 Rx 3
""",
    "pcan 2.1": f""";$FILEVERSION=2.1
;$COLUMNS=N,O,T,B,I,d,R,L,D
{WITH_HEAD} 1 1841.200 DT 1 0123 Rx - 2 0A 0B
 2 1842.000 FD 1 18FECA0E Tx - 1 FF
 3 1843.000 ER 1 - Rx - 5 04 00 02 00 00
 4 1844.000 RR 1 0100 Rx - 3
""",
    "canhacker 2": """Time   ID     DLC Data                    Comment
1,8412 0123 2 0A 0B
1,842  18FECA0E 1 FF ab
1,844 0100 3 RTR
""",
    "canhacker 3": """@ TEXT @ 3 @ 64 @ 0 @ 2 @ 3 @ 00:00:01.000 @
# $LocalTime=12:00:00.000
1,8412\t1\t0004\t123\t2\t0A 0B\t00000000\t\t
1,842\t1\t80000004\t18FECA0E\t1\tFF\t00000000\t\t
""",
}


@pytest.mark.parametrize("form", HAND)
def test_traces_of_every_version_have_the_same_frames(form, tmp_path):
    path = tmp_path / "drive.trc"
    path.write_text(HAND[form])
    log = read_log(path)
    assert log.id.tolist() == [0x123, 0x18FECA0E | EXTENDED]
    assert [bytes(row[:n]) for row, n in zip(log.data, log.length, strict=True)] == [b"\x0a\x0b", b"\xff"]
    assert round((log.t_ns[1] - log.t_ns[0]) / 1e3) == 800
    start_s = 1506729600 + 43200 if "STARTTIME" in HAND[form] else 0.0
    assert log.t_ns[0] / 1e9 == pytest.approx(start_s + 1.8412, abs=1e-5)
    if form != "canhacker 3":
        assert log.left_out["remote frames"] == 1


HEAD = "***BUSMASTER Ver 3.2.2***\n***HEX***\n***SYSTEM MODE***\n"
LINES = {
    "busmaster.log": HEAD
    + "11:49:12:9420 Rx 1 0x123 s 2 0A 0B\n11:49:12:9428 Tx 1 0x18FECA0E x 1 FF\n"
    + "11:49:12:9500 Rx 1 0x100 sr 3\n***[STOP LOGGING SESSION]***\n",
    "decimal.log": HEAD.replace("HEX", "DEC")
    + "11:49:12:9420 Rx 1 291 s 2 10 11\n11:49:12:9428 Tx 1 419351054 x 1 255\n11:49:13:0 Rx 1 9 sr 0\n",
    "relative.log": HEAD.replace("SYSTEM", "RELATIVE")
    + "0:0:1:0 Rx 1 0x123 s 2 0A 0B\n0:0:0:8 Tx 1 0x18FECA0E x 1 FF\n0:0:0:9999 Rx 1 0x9 sr 0\n",
    "midnight.txt": "23:59:59:9996 Rx 1 0x123 s 2 0A 0B\n00:00:00:0004 Tx 1 0x18FECA0E x 1 FF\n",
    "ovms.crtd": "1841.2000 CXX Info Type:crtd;\n1841.2000 1R11 123 0A 0B\n1841.2008 1T29 18FECA0E FF\n",
    "canking.txt": "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
    " 0    00000123         2  0A  0B                             1841.200000 R\n"
    " 0    18FECA0E X       1  FF                                 1841.200800 T\n"
    " 0    00000100 R       3                                     1841.3 R\n",
    "canking decimal.txt": " 0    291         2  10  11     1.200000 R\n"
    " 0    419351054 X       1  255  1.200800 T\n",
    "microchip.can": "//----\nMicrochip Technology Inc.\n//----\n"
    "1200;RX;0x123;2;0x0A;0x0B;\n1201;TX;0x18FECA0E;1;0xFF\n",
    "adapter.slcan": "V1013\nt12320A0BEA5F\nT18FECA0E1FF0000\n",
    "terminal.log": "(1841.2000) t12320A0B\r\n(1841.2008) T18FECA0E1FF\r\n",
}
"""Forms with a line a frame, each with the same two frames 0.8 ms apart, or 1 ms where it counts ms."""


@pytest.mark.parametrize("name", LINES)
def test_frames_with_a_line_each_are_read(name, tmp_path):
    (tmp_path / name).write_text(LINES[name])
    log = read_log(tmp_path / name)
    assert log.id.tolist() == [0x123, 0x18FECA0E | EXTENDED]
    assert [bytes(row[:n]) for row, n in zip(log.data, log.length, strict=True)] == [b"\x0a\x0b", b"\xff"]
    in_ms = name in ("microchip.can", "adapter.slcan")
    assert round((log.t_ns[1] - log.t_ns[0]) / 1e3) == (1000 if in_ms else 800)
    assert log.left_out.get("remote frames", 0) == LINES[name].count(" sr ") + LINES[name].count("100 R ")


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("busmaster.log", "s 2 0A", "s 3 0A", r"line 4: no frame \(2 bytes, where its length says 3"),
        ("microchip.can", "2;0x0A", "3;0x0A", "line 4: no frame"),
        ("canking.txt", "2  0A", "1  0A", "line 2: no frame"),
        (
            "adapter.slcan",
            "A0BEA5F",
            "A0B",
            "line 2: no frame .no time: slcan's adapter writes one after its command Z1",
        ),
        ("ovms.crtd", "0A 0B", "0A 1FF", "line 2: no frame"),
    ],
)
def test_a_line_that_is_no_whole_frame_is_refused(name, old, new, said, tmp_path):
    (tmp_path / name).write_text(LINES[name].replace(old, new))
    with pytest.raises(InputError, match=said):
        read_log(tmp_path / name)


@pytest.mark.parametrize(
    ("suffix", "options"),
    [(".asc", {}), (".trc", {}), (".trc", {"file_version": can.TRCFileVersion.V1_0}), (".blf", {})],
)
def test_what_python_can_writes_is_read(suffix, options, tmp_path):
    path = tmp_path / f"drive{suffix}"
    with can.Logger(path) as writer:
        for name, value in options.items():
            setattr(writer, name, value)
        for message in MESSAGES:
            writer(message)
    log = read_log(path)
    data = [m for m in MESSAGES if not m.is_remote_frame]
    assert log.left_out == ({} if suffix == ".trc" else {"remote frames": 1}) and len(log.channels) == 1
    assert [one & 0x1FFFFFFF for one in log.id.tolist()] == [m.arbitration_id for m in data]
    assert [bytes(row[:n]) for row, n in zip(log.data, log.length, strict=True)] == [
        bytes(m.data) for m in data
    ]
    np.testing.assert_allclose(np.diff(log.t_ns) / 1e9, [0.003, 0.02], atol=1.1e-3)


@pytest.mark.parametrize(
    ("form", "old", "new", "said"),
    [
        ("pcan 1.1", "0123 2 0A 0B", "0123 3 0A 0B", "line 4: no frame .2 bytes, where its length says 3"),
        ("pcan 2.1", "- 2 0A 0B", "- 2 0A", "line 5: no frame .1 bytes, where its length says 2"),
        ("pcan 1.2", "1.2", "1.9", r"FILEVERSION: 1.9; expected one of 1.0, 1.1, 1.2, 1.3, 2.0"),
        ("pcan 1.1", "43008.5", "noon", "line 2: 'noon' is no number"),
        ("pcan 1.0", "0123 2 0A 0B", "0123", "line 2: no frame"),
        ("canhacker 2", "0123 2 0A 0B", "0123 9 0A 0B", "line 2: no frame .2 bytes"),
        ("canhacker 3", "0A 0B", "0A ZZ", "line 3: no frame .1 bytes"),
    ],
)
def test_a_line_that_contradicts_itself_is_refused_by_its_number(form, old, new, said, tmp_path):
    path = tmp_path / "drive.trc"
    path.write_text(HAND[form].replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_log(path)


def test_an_asc_whose_length_is_not_that_of_its_bytes_is_refused(tmp_path):
    path = tmp_path / "drive.asc"
    head = "date Tue Jun 04 10:00:00.000 am 2024\nbase hex  timestamps absolute\ninternal events logged\n"
    start = "Begin Triggerblock Tue Jun 04 10:00:00.000 am 2024\n   0.000000 Start of measurement\n"
    path.write_text(head + "// version 9.0.0\n" + start + "   0.100000 1  123             Rx   d 8 9B 04\n")
    with pytest.raises(
        InputError, match=r"frame 1: cannot be read .ValueError: 2 bytes, where its length says 8"
    ):
        read_log(path)


def test_times_between_frames_are_named(tmp_path):
    """candump -t d: each time counts from the frame before."""
    path = tmp_path / "drive.log"
    steps = (0.0, 0.009, 0.001) * 20
    path.write_text("".join(f" ({s:010.6f})  can0  123   [2]  0A {k:02X}\n" for k, s in enumerate(steps)))
    with pytest.raises(
        InputError, match=r"times: 39 of 60 go back: .* as candump -t d writes; expected absolute"
    ):
        read_log(path)
    path.write_text("".join(f" (000.010000)  can0  123   [2]  0A {k:02X}\n" for k in range(60)))
    with pytest.raises(InputError, match="times: all 60 are the same: each counts from the frame before"):
        read_log(path)


def test_dates_of_candump_are_read(tmp_path):
    """candump -t A."""
    path = tmp_path / "drive.log"
    path.write_text(
        " (2024-05-01 23:59:59.500000)  can0  123   [2]  0A F1\n"
        " (2024-05-02 00:00:00.250000)  can0  18F0093E   [1]  FF\n"
    )
    log = read_log(path)
    assert isinstance(log, Frames) and log.length.tolist() == [2, 1]
    assert log.t_ns.tolist() == [1714607999 * 10**9 + 5 * 10**8, 1714608000 * 10**9 + 25 * 10**7]
