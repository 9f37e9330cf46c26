"""A wrong line of a DBC costs itself; a type that contradicts its range is read by the range."""

import canmatrix.formats
import cantools
import pytest

from lpvguard.base.errors import InputWarning
from lpvguard.can.database_lines import read_sound_lines
from lpvguard.can.decode import load_database
from lpvguard.can.sign_bits import sign_bits

HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A\n\n'
SPEED = """BO_ 253 SPEED: 8 A
 SG_ V : 0|16@1+ (0.01,0) [0|655.35] "km/h" A
 SG_ GEAR : 16|4@1+ (1,0) [0|15] "" A
"""
YAW = """BO_ 316495015 YAW: 8 A
 SG_ RATE : 0|16@1- (0.01,0) [-300|300] "deg/s" A
 SG_ OK : 16|2@1+ (1,0) [0|3] "" A
"""


def test_values_of_a_message_whose_flag_lacks_stay_its_values():
    database, said = read_sound_lines(HEAD + SPEED + YAW + 'VAL_ 316495015 OK 0 "no" 1 "yes";\n')
    assert [text.partition(":")[0] for text in said] == ["line 12"]
    assert database.get_message_by_name("YAW").get_signal_by_name("OK").choices[1].name == "yes"


def test_a_statement_without_its_end_costs_none_behind_it():
    wrong = 'VAL_ 253 GEAR 0 "N" 1 "D"\nVAL_ 253 V 65535 "none";\nVAL_ 253 GONE 1 "on";\nSG_ lost\n'
    database, said = read_sound_lines(HEAD + SPEED + wrong)
    signals = {s.name: s for s in database.messages[0].signals}
    assert signals["GEAR"].choices is None and signals["V"].choices[65535].name == "none"
    assert [text.rpartition("line ")[2][:2] for text in said] == ["12", "14", "15"]


def test_a_message_without_a_length_costs_itself():
    database, said = read_sound_lines(
        HEAD + "BO_ 5 SHORT: A\n" + ' SG_ X : 0|8@1+ (1,0) [0|1] "" A\n' + SPEED
    )
    assert [m.name for m in database.messages] == ["SPEED"] and "BO_ 5 SHORT" in said[0]


@pytest.mark.parametrize("head", ["B0_ 427 LOST: 8 A", "427 LOST : 8 A"])
def test_signals_behind_a_wrong_head_go_to_no_other_message(head):
    lost = f'{head}\n SG_ X : 0|8@1+ (1,0) [0|1] "" A\n'
    database, said = read_sound_lines(HEAD + SPEED + lost + SPEED.replace("253 SPEED", "254 AGAIN"))
    assert {m.name: len(m.signals) for m in database.messages} == {"SPEED": 2, "AGAIN": 2}
    assert [text.split(": ")[2][:6].strip() for text in said] == [head[:6].strip(), "SG_ X"]


@pytest.mark.parametrize("stated", ["-3276.8|3276.7", "-780|780"])
def test_the_range_of_a_signed_signal_is_taken_before_its_type(tmp_path, stated):
    angle = f' SG_ ANGLE : 0|16@1+ (0.1,0) [{stated}] "deg" A\n'
    (tmp_path / "car.dbc").write_text(HEAD + "BO_ 37 STEER: 8 A\n" + angle)
    with pytest.warns(InputWarning, match="STEER.ANGLE: read as signed because of the stated range"):
        database = load_database(tmp_path / "car.dbc")
    assert database.messages[0].signals[0].is_signed


def test_a_form_that_cantools_does_not_read_is_read_by_canmatrix(tmp_path):
    sound = HEAD + SPEED + YAW.replace("316495015", "254")
    (matrix,) = canmatrix.formats.loads(sound.encode(), "dbc").values()
    with (tmp_path / "car.dbf").open("wb") as stream:
        canmatrix.formats.dump(matrix, stream, "dbf")
    signals = {s.name: s for m in load_database(tmp_path / "car.dbf").messages for s in m.signals}
    assert set(signals) == {"V", "GEAR", "RATE", "OK"}
    assert signals["RATE"].is_signed and signals["RATE"].scale == 0.01 and signals["V"].unit == "km/h"


def test_messages_of_one_identifier_are_named(tmp_path):
    (tmp_path / "car.dbc").write_text(HEAD + SPEED + SPEED.replace("253 SPEED", "253 AGAIN"))
    with pytest.warns(InputWarning, match="messages SPEED and AGAIN have one identifier, 0xfd: each is read"):
        load_database(tmp_path / "car.dbc")


def test_a_signal_of_a_thousand_bits_is_no_reason_to_refuse_a_database(tmp_path):
    text = ' SG_ TEXT : 0|14280@1+ (1,0) [0|255] "" A\n'
    (tmp_path / "car.dbc").write_text(HEAD + "BO_ 2566843904 LONG: 1785 A\n" + text + SPEED)
    assert [m.name for m in load_database(tmp_path / "car.dbc").messages] == ["LONG", "SPEED"]


@pytest.mark.parametrize(
    ("magnitude", "bit", "is_sign"),
    [
        ("BR5_Giergeschw : 0|14@1+ (0.01,0)", "BR5_Vorzeichen : 15|1@1+", True),
        ("LH3_BLW : 0|12@1+ (0.15,0)", "LH3_BLWSign : 12|1@1+", True),
        ("LH3_BLW : 0|12@1+ (0.15,0)", "LH3_Sign : 40|1@1+", False),  # of which?
        ("Yaw_Rate : 0|16@1+ (0.007,-229)", "Yaw_Rate_VZ : 16|1@1+", False),  # has its sign
    ],
)
def test_a_bit_of_other_words_tells_the_sign_of_what_it_follows(magnitude, bit, is_sign):
    signals = f' SG_ {magnitude} [0|0] "" A\n SG_ {bit} (1,0) [0|1] "" A\n'
    message = cantools.database.load_string(HEAD + "BO_ 1 M: 8 A\n" + signals, "dbc").messages[0]
    assert bool(sign_bits(message)) == is_sign
