"""A range that the bits of its signal contradict is named and set aside; one that is only rounded is kept."""

import cantools
import pytest

from lpvguard.base.errors import InputWarning
from lpvguard.can import own
from lpvguard.can.decode import contradicting_range


def signal_of(bits: str, numbers: str, stated: str):
    signal = f' SG_ RATE : {bits} ({numbers}) [{stated}] "deg/s" A'
    text = f'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 36 YAW: 8 A\n{signal}\n'
    return cantools.database.load_string(text, "dbc", strict=False).messages[0].signals[0]


@pytest.mark.parametrize(
    ("bits", "numbers", "stated", "contradicts"),
    [
        ("1|10@0+", "0.244,-125", "0|65535", True),  # raw ends where physical ones belong
        ("7|16@0-", "0.1,0", "0|65535", True),  # a signed signal with the range of an unsigned one
        ("7|16@0-", "0.1,0", "-500|500", False),
        ("7|16@0+", "0.01,0", "0|250", False),
        ("7|8@0+", "1,0", "0|300", False),  # forbids nothing
        ("7|16@0-", "0.1,0", "-3276.8|3276.7", False),
        ("7|16@0+", "-0.1,100", "-7000|50", True),
        ("7|16@0+", "0.1,0", "0|0", False),  # states none
    ],
)
def test_a_range_is_set_aside_where_its_bits_contradict_it(bits, numbers, stated, contradicts):
    signal = signal_of(bits, numbers, stated)
    assert bool(contradicting_range(signal)) == contradicts
    scale, offset = (float(number) for number in numbers.split(","))
    whole = 2**signal.length
    raw = (-whole // 2, whole // 2 - 1) if signal.is_signed else (0, whole - 1)
    low, high = sorted(offset + scale * end for end in raw)
    if contradicts:
        with pytest.warns(InputWarning, match="contradicts its bits"):
            assert own._accepted(signal, low, high) is None
    elif stated != "0|0":
        kept = own._accepted(signal, low, high)
        assert kept["min"] >= low and kept["max"] <= high


@pytest.mark.parametrize(
    ("bits", "numbers", "stated", "contradicts"),
    [
        ("7|16@0-", "0.1,0", "0|3276.7", True),  # every right turn would be dropped
        ("1|10@0+", "0.244,-125", "0|124.6", True),
        ("7|16@0-", "-0.1,0", "-3276.7|0", True),
        ("7|16@0+", "0.1,0", "0|6553.5", False),  # no bits for a sign
        ("7|16@0-", "0.1,0", "-100|3276.7", False),
    ],
)
def test_a_range_of_one_sign_is_set_aside_where_the_quantity_has_both(bits, numbers, stated, contradicts):
    signal = signal_of(bits, numbers, stated)
    assert not contradicting_range(signal)
    assert bool(contradicting_range(signal, both_signs=True)) == contradicts
