"""Every fault of recorded drives changes the samples that it should, and no other."""

from __future__ import annotations

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
]
"""Fault, and inputs and outputs with it."""


@pytest.mark.parametrize(("fault", "u", "y"), BY_HAND, ids=lambda x: x.label if isinstance(x, Fault) else "")
def test_samples_from_the_start_on_are_those_worked_out_by_hand(fault, u, y):
    sound = Drive("sound", TS * np.arange(8), np.full(8, 10.0), np.array(U)[:, None], np.array(Y)[:, None])
    faulty = inject(sound, fault, FROM_S, TS)
    np.testing.assert_allclose(faulty.u[:, 0], u, rtol=1e-15)
    np.testing.assert_allclose(faulty.y[:, 0], y, rtol=1e-15)
    np.testing.assert_array_equal(faulty.t, sound.t)
    np.testing.assert_array_equal(faulty.v, sound.v)
    assert sound.u[:, 0].tolist() == U and sound.y[:, 0].tolist() == Y, "the sound drive stays as it was"


def test_every_kind_is_worked_out_and_an_unknown_one_is_refused():
    assert {fault.kind for fault, _, _ in BY_HAND} == set(KINDS)
    with pytest.raises(InputError, match="gain or freeze"):
        Fault("stuck")
    with pytest.raises(InputError, match="not negative"):
        Fault("input_delay", -0.1)
