"""Drives to frames and back: the numpy encoder against the compiled codec's rules, cantools and
autosar-e2e."""

from __future__ import annotations

import can
import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.catalogue import load_catalogue
from lpvguard.can.decode import decode_all, own_database
from lpvguard.can.logs import read_log
from lpvguard.can.play import encode, encode_raw, frames_of_drive, play, protect, write_candump

CATALOGUE = load_catalogue()
T = np.arange(0, 5, 0.02)
VALUES = {
    ("VDC2", "yaw_rate"): 0.1 * np.sin(T),
    ("VDC2", "steering_wheel_angle"): np.cos(T),
    ("CCVS1", "wheel_based_speed"): 54 + T,
    ("GUARD_IN", "dp_measured"): np.sin(2 * T),
}


def test_a_drive_survives_the_way_through_a_log(tmp_path):
    write_candump(frames_of_drive(T, VALUES), tmp_path / "drive.log")
    frames = read_log(tmp_path / "drive.log")
    decoded = decode_all(frames, own_database())
    for (message, signal), x in VALUES.items():
        samples = decoded[message][signal]
        s = next(s for s in CATALOGUE.message(message).signals if s.name == signal)
        assert (
            np.abs(samples.value - np.interp(frames.t_ns[samples.frame] / 1e9, T, x)).max()
            <= 0.5001 * s.scale
        )
    assert (
        len(decoded["VDC2"]["yaw_rate"].value) == 499
        and len(decoded["CCVS1"]["wheel_based_speed"].value) == 50
    )
    assert decoded["VDC2"]["lateral_acceleration"].left_out == {"not available or error": 499}
    assert len(decoded["VDC2"]["lateral_acceleration"].value) == 0


@pytest.mark.parametrize(
    "message", [m for m in CATALOGUE.messages if m.codec == "generated"], ids=lambda m: m.name
)
def test_every_raw_value_is_reached_and_the_ends_saturate(message):
    for s in message.signals:
        raw = np.arange(s.raw_max + 1)
        assert np.array_equal(encode_raw(s, s.physical(raw)), raw)
        assert encode_raw(s, np.array([-1e9, 1e9, np.nan, -np.inf, np.inf])).tolist() == [
            0,
            s.raw_max,
            (1 << s.length) - 1,
            0,
            s.raw_max,
        ]


def test_protection_equals_autosar_e2e():
    p11 = pytest.importorskip("e2e.p11", reason="pip install autosar-e2e")
    data = np.random.default_rng(3).integers(0, 256, (1000, 8), np.uint8)
    protect(data, 0x4C01, first_counter=7)
    assert (data[:, 1] & 0x0F).tolist() == [(7 + k) % 15 for k in range(1000)]
    for row in data:
        assert p11.e2e_p11_check(bytearray(row.tobytes()), 0x4C01, data_id_mode=p11.E2E_P11_DATAID_BOTH)


def test_frames_of_the_catalogue_are_protected_and_padded():
    data = encode(CATALOGUE.message("GUARD_IN"), {"dp_measured": np.zeros(3)}, 3)
    assert (data[:, 4:] == 0xFF).all() and (data[:, 1] == [0xF0, 0xF1, 0xF2]).all()


def test_play_keeps_the_pace_and_the_frames():
    frames = frames_of_drive(T, VALUES)
    now, sent = [0.0], []

    class Bus:
        def send(self, message):
            sent.append((now[0], message.arbitration_id, message.is_extended_id, bytes(message.data)))

    def sleep(seconds):
        now[0] += seconds

    play(frames, Bus(), speed=10.0, sleep=sleep, clock=lambda: now[0])
    assert np.allclose([s[0] for s in sent], frames.t_ns / 1e10, atol=1e-9)
    assert [s[1] for s in sent] == (frames.id & 0x1FFFFFFF).tolist() and all(s[2] for s in sent)
    assert b"".join(s[3] for s in sent) == frames.data.tobytes()


def test_play_on_a_bus_of_python_can():
    frames = frames_of_drive(T[:50], {place: x[:50] for place, x in VALUES.items()})
    with can.Bus("play", interface="virtual") as sender, can.Bus("play", interface="virtual") as receiver:
        play(frames, sender, speed=np.inf)
        got = [receiver.recv(1.0) for _ in range(len(frames))]
    assert [m.arbitration_id for m in got] == (frames.id & 0x1FFFFFFF).tolist()


def test_an_unknown_message_is_refused_by_name():
    with pytest.raises(InputError, match=r"VDC3.*one of VDC2"):
        frames_of_drive(T, {("VDC3", "yaw_rate"): T})
