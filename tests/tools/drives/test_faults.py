"""Every fault of recorded drives changes the samples that it should, and no other."""

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.drives.faults import KINDS, Fault, inject
from lpvguard.drives.tables import Drive

TS, FROM_S = 0.1, 0.3
U = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0]
Y = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
BY_HAND = [
    (Fault("gain", 0.5), U, [0.0, 1.0, 2.0, 1.5, 2.0, 2.5, 3.0, 3.5]),
    (Fault("freeze"), U, [0.0, 1.0, 2.0, 3.0, 3.0, 3.0, 3.0, 3.0]),
    (Fault("bias", 0.5), U, [0.0, 1.0, 2.0, 3.5, 4.5, 5.5, 6.5, 7.5]),
    (Fault("input_delay", 0.2), [0.0, 10.0, 20.0, 10.0, 20.0, 30.0, 40.0, 50.0], Y),
    (Fault("output_delay", 0.2), U, [0.0, 1.0, 2.0, 1.0, 2.0, 3.0, 4.0, 5.0]),
    (Fault("output_delay", 0.5), U, [0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 2.0]),
    (Fault("dead_zone", 3.5), U, [0.0, 1.0, 2.0, 0.0, 0.5, 1.5, 2.5, 3.5]),
    (Fault("saturation", 4.0), U, [0.0, 1.0, 2.0, 12 / 7, 2.0, 20 / 9, 2.4, 28 / 11]),
    (Fault("gain", 0.5, also=Fault("bias", 0.5)), U, [0.0, 1.0, 2.0, 2.0, 2.5, 3.0, 3.5, 4.0]),
]
"""Fault, and inputs and outputs with it."""
RAMP_S = 0.4
RAMPED = [
    (Fault("gain", 0.5), U, [0.0, 1.0, 2.0, 3.0, 3.5, 3.75, 3.75, 3.5]),
    (Fault("freeze"), U, [0.0, 1.0, 2.0, 3.0, 3.75, 4.0, 3.75, 3.0]),
    (Fault("bias", 0.8), U, [0.0, 1.0, 2.0, 3.0, 4.2, 5.4, 6.6, 7.8]),
    (Fault("input_delay", 0.2), [0.0, 10.0, 20.0, 30.0, 35.0, 40.0, 45.0, 50.0], Y),
    (Fault("output_delay", 0.2), U, [0.0, 1.0, 2.0, 3.0, 3.5, 4.0, 4.5, 5.0]),
    (Fault("dead_zone", 2.0), U, [0.0, 1.0, 2.0, 3.0, 3.5, 4.0, 4.5, 5.0]),
    (Fault("saturation", 3.0), U, [0.0, 1.0, 2.0, 3.0, 3.0, 30 / 11, 2.4, 2.1]),
    (Fault("gain", 0.5, also=Fault("bias", 0.8)), U, [0.0, 1.0, 2.0, 3.0, 3.7, 4.15, 4.35, 4.3]),
]
"""The same with a ramp: from FROM_S on the share of the fault is 0, 1/4, 1/2, 3/4, 1."""


@pytest.mark.parametrize(
    ("ramp_s", "fault", "u", "y"),
    [*((0.0, *case) for case in BY_HAND), *((RAMP_S, *case) for case in RAMPED)],
    ids=lambda x: x.label if isinstance(x, Fault) else "",
)
def test_samples_from_the_start_on_are_those_worked_out_by_hand(ramp_s, fault, u, y):
    sound = Drive("sound", TS * np.arange(8), np.full(8, 10.0), np.array(U)[:, None], np.array(Y)[:, None])
    faulty = inject(sound, fault, FROM_S, TS, ramp_s)
    np.testing.assert_allclose(faulty.u[:, 0], u, rtol=1e-14)
    np.testing.assert_allclose(faulty.y[:, 0], y, rtol=1e-14)
    np.testing.assert_array_equal(faulty.t, sound.t)
    np.testing.assert_array_equal(faulty.v, sound.v)
    assert sound.u[:, 0].tolist() == U and sound.y[:, 0].tolist() == Y, "the sound drive stays as it was"


def test_every_kind_is_worked_out_and_an_unknown_one_is_refused():
    for cases in (BY_HAND, RAMPED):
        assert {fault.kind for fault, _, _ in cases} == set(KINDS)
    with pytest.raises(InputError, match="gain or freeze"):
        Fault("stuck")
    with pytest.raises(InputError, match="not negative"):
        Fault("input_delay", -0.1)
