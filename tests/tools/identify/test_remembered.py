"""Memory of filters at a restart, against the responses themselves."""

import numpy as np
import pytest
from scipy.signal import sosfilt

from lpvguard.identify.remembered import free_response, remembered, section_states

SECTIONS = np.array([[1.0, 0.3, 0.2, 1.0, -1.2, 0.5], [0.5, -0.4, 0.0, 1.0, -0.8, 0.0]])
RHO, N = 0.93, 60


def least(sections, x, settle):
    """Least m, from every response to a past that ends, sample by sample."""
    largest = 0.0
    for t0 in range(len(x)):
        response = sosfilt(sections, np.r_[x[:t0], np.zeros(600)])
        if settle is not None:
            response[: t0 + settle] = 0.0
        energy = 0.0
        for T, y in enumerate(response):
            energy = RHO**2 * energy + y**2
            if t0 <= T:
                largest = max(largest, energy / RHO ** (2 * (T - t0 + 1)))
    return np.sqrt(largest)


@pytest.mark.parametrize("settle", [None, 0, 7])
def test_it_is_the_least_that_holds(settle):
    x = np.random.default_rng(1).standard_normal(N)
    assert remembered(SECTIONS, x, RHO, settle) == pytest.approx(least(SECTIONS, x, settle), rel=1e-9)


def test_repeated_poles_and_sections_without_states_are_no_special_case():
    double = np.array([[1.0, 0.0, 0.0, 1.0, -1.4, 0.49], [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    x = np.random.default_rng(3).standard_normal(N)
    assert remembered(double, x, RHO) == pytest.approx(least(double, x, None), rel=1e-9)
    through = np.array([[2.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    assert remembered(through, x, RHO) == pytest.approx(least(through, x, None), rel=1e-9)
    assert remembered(through, 0.0 * x, RHO) == 0.0


def test_states_are_those_of_the_filter_and_carry_its_free_response():
    x = np.random.default_rng(4).standard_normal(N)
    states, y = section_states(SECTIONS, x)
    np.testing.assert_allclose(y, sosfilt(SECTIONS, x), atol=1e-12)
    A, C = free_response(SECTIONS)
    for t in (1, 17, N - 1):
        _, zi = sosfilt(SECTIONS, x[:t], zi=np.zeros((2, 2)))
        np.testing.assert_allclose(states[:, t], zi.reshape(-1), atol=1e-12)
        response, _ = sosfilt(SECTIONS, np.zeros(5), zi=zi)
        np.testing.assert_allclose(
            response, [C @ np.linalg.matrix_power(A, k) @ states[:, t] for k in range(5)], atol=1e-12
        )
