"""Magnitudes with their sign in a bit beside them, and messages that are on two channels."""

import math

import cantools
import pytest

from lpvguard.base.errors import InputError, InputWarning
from lpvguard.can.decode import load_database
from lpvguard.can.logs import read_log
from lpvguard.can.sign_bits import sign_bits
from lpvguard.drives.ingest import ingest
from lpvguard.start.new_project import new
from steered_car import write_logs


@pytest.mark.parametrize("angle", ["angle", "angle_deg"])
def test_a_column_of_a_table_gets_the_sign_of_the_column_beside_it(tmp_path, angle):
    rows = "".join(f"{0.02 * k:.2f},{k % 7},{k % 3 == 0:d},{k % 5}\n" for k in range(30))
    (tmp_path / "log.csv").write_text(f"t,{angle},angle_sign,other_sign\n" + rows)
    with pytest.warns(InputWarning, match=f"column {angle} holds no sign and gets that of angle_sign"):
        series = read_log(tmp_path / "log.csv").series
    assert series[angle].value[:4].tolist() == [0.0, 1.0, 2.0, -3.0]


DBC = """VERSION ""

NS_ :

BS_:

BU_: A

BO_ 134 LW1: 8 A
 SG_ LW1_Lenkwinkel : 0|13@1+ (0.1,0) [0|800] "deg" A
 SG_ LW1_VZ_Lenkwinkel : 13|1@1+ (1,0) [0|1] "" A

BO_ 257 YAW: 8 A
 SG_ YawRate : 0|14@1+ (0.01,0) [0|163.82] "deg/s" A
 SG_ YawRateSign : 14|1@1+ (1,0) [0|1] "" A

BO_ 253 SPEED: 8 A
 SG_ Vehicle_Speed : 0|16@1+ (0.01,0) [0|655.35] "km/h" A
"""


@pytest.fixture
def logs(tmp_path):
    """A database and two logs of a car, steered to both sides."""
    (tmp_path / "car.dbc").write_text(DBC)
    database = cantools.database.load_string(DBC)

    def frames(v, angle, yaw):
        for name, values in (
            ("LW1", {"LW1_Lenkwinkel": abs(angle), "LW1_VZ_Lenkwinkel": angle < 0}),
            ("YAW", {"YawRate": abs(yaw), "YawRateSign": yaw < 0}),
            ("SPEED", {"Vehicle_Speed": 3.6 * v}),
        ):
            message = database.get_message_by_name(name)
            yield f"{message.frame_id:03X}#{message.encode(values, strict=False).hex().upper()}"

    return tmp_path / "car.dbc", write_logs(
        tmp_path,
        1500,
        lambda t: 12 + 2 * math.sin(0.2 * t),
        lambda t: 40 * math.sin(0.7 * t) + 20 * math.sin(2.1 * t),
        frames,
    )


def test_a_magnitude_finds_the_bit_of_its_sign():
    database = cantools.database.load_string(DBC)
    bits = {m.name: sign_bits(m) for m in database.messages}
    assert bits == {
        "LW1": {"LW1_Lenkwinkel": "LW1_VZ_Lenkwinkel"},
        "YAW": {"YawRate": "YawRateSign"},
        "SPEED": {},
    }


def test_a_car_with_its_signs_apart_is_read_with_them(logs, tmp_path):
    dbc, paths = logs
    made = new("mine", paths, tmp_path / "out", dbc=dbc, wheelbase_m=2.7)
    assert abs(made.proposals["input"].factor * 15 - 1) < 0.1
    again = ingest(paths, dbc=dbc, signals_map=tmp_path / "out" / "signals.toml", out=tmp_path / "again")
    table = (tmp_path / "again" / "d0.csv").read_text()
    assert table == (tmp_path / "out" / "drives" / "d0.csv").read_text() and len(again) == 2
    delta = [float(line.split(",")[2]) for line in table.splitlines()[1:]]
    assert min(delta) < -0.03 and max(delta) > 0.03
    text = (tmp_path / "out" / "signals.toml").read_text().replace('sign = "YawRateSign"', 'sign = "Sign"')
    (tmp_path / "signals.toml").write_text(text)
    with pytest.raises(InputError, match="sign: no signal Sign"):
        ingest(paths, dbc=dbc, signals_map=tmp_path / "signals.toml", out=tmp_path / "other")


def test_a_message_on_two_channels_asks_for_one(logs, tmp_path):
    dbc, paths = logs
    for path in paths:
        text = path.read_text()
        path.write_text(text + text.replace("can0", "can1"))
    with pytest.raises(InputError, match="LW1: is on the channels can0 and can1; expected --channel"):
        new("mine", paths, tmp_path / "out", dbc=dbc, wheelbase_m=2.7)
    new("mine", paths, tmp_path / "out", dbc=dbc, wheelbase_m=2.7, channel="can1")
    assert 'channel = "can1"' in (tmp_path / "out" / "signals.toml").read_text()


def test_an_identifier_of_29_bits_without_its_flag_is_read_and_named(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC.replace("BO_ 257 YAW", "BO_ 316495015 YAW"))
    with pytest.warns(InputWarning, match="line 13: BO_ 316495015 YAW: 8 A: read as a 29-bit identifier"):
        database = load_database(tmp_path / "car.dbc")
    yaw = database.get_message_by_name("YAW")
    assert yaw.is_extended_frame and yaw.frame_id == 316495015 and len(database.messages) == 3
