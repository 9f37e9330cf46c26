"""The plain DFT of a frame against its equation, on a model of hand-made numbers: its own data leave nothing,
and what is added to them is found."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard.drives.dft import lines, resolvent, spectra
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import Drive

N, TS, START = 60, 0.02, 7
A = np.array([[0.9, 0.15, 0.0], [-0.2, 0.85, 0.1], [0.05, 0.0, 0.6]])
B_OLD = np.array([[0.1, -0.3], [0.4, 0.2], [-0.2, 0.5]])
B_NEW = np.array([[0.3, 0.1], [-0.1, 0.6], [0.7, -0.4]])
C = np.array([[1.0, 0.0, 0.5], [0.0, -2.0, 1.0]])
INPUT_OFFSET, OUTPUT_OFFSET = np.array([0.02, -0.1]), np.array([0.3, -0.7])


class HandModel:
    """x_{k+1} = A x_k + B_old u_{k-1} + B_new u_k, y = C x + offset; the same at every speed but for A, which
    tells which speed was asked for."""

    Ts, n, C, output_offset = TS, 3, C, OUTPUT_OFFSET

    def discretise(self, v: np.ndarray) -> SimpleNamespace:
        assert v.shape == (1,)
        scale = v[0] / 10.0
        return SimpleNamespace(Ad=scale * A[None], B_old=B_OLD[None], B_new=B_NEW[None])

    def acting_inputs(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        du = u - INPUT_OFFSET
        return np.vstack([du[:1], du[:-1]]), du


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    cycles = np.array([0, 2, 3, 5, 8, 11])
    return Estimator(TS, np.full(len(cycles), N), cycles, 0, 0.15, (1.0, 50.0), "rectangular")


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Longer than the frame on both sides; only in the frame is the mean speed 10 m/s."""
    random = np.random.default_rng(8)
    n = START + N + 11
    u = INPUT_OFFSET + 0.3 * random.standard_normal((n, 2))
    old, new = HandModel().acting_inputs(u)
    x = np.array([2.0, -1.0, 0.5])
    y = np.empty((n, 2))
    for k in range(n):
        y[k] = C @ x + OUTPUT_OFFSET
        x = A @ x + B_OLD @ old[k] + B_NEW @ new[k]
    v = np.full(n, 13.0)
    v[START : START + N] = 10.0 + np.tile([-0.5, 0.5], N // 2)
    return Drive("d", np.arange(n) * TS, v, u, y)


def test_a_line_reads_the_amplitude_of_its_sinusoid_and_dc_the_mean(estimator):
    n = np.arange(N)
    x = np.column_stack(
        [1.5 + 0.4 * np.cos(2 * np.pi * 5 * n / N + 0.3), 2.0 * np.sin(2 * np.pi * 8 * n / N)]
    )
    X = lines(x, estimator)
    expected = np.zeros((6, 2), complex)
    expected[0, 0], expected[3, 0], expected[4, 1] = 1.5, 0.4 * np.exp(0.3j), -2.0j
    np.testing.assert_allclose(X, expected, atol=1e-13)
    first = replace(estimator, cycles=np.array([0, 1]), length=np.full(2, N))
    assert abs(lines(np.cos(2 * np.pi * n / N)[:, None], first)[1, 0]) == pytest.approx(1.0)
    several = lines(np.stack([x, 3 * x]), estimator)
    np.testing.assert_allclose(several, [X, 3 * X], atol=1e-13)


def test_the_resolvent_is_an_inverse_on_the_circle(estimator):
    z, inverse = resolvent(A, estimator)
    for k, cycles in enumerate(estimator.cycles):
        assert z[k] == pytest.approx(np.exp(2j * np.pi * cycles / N))
        np.testing.assert_allclose(inverse[k] @ (z[k] * np.eye(3) - A), np.eye(3), atol=1e-13)


def test_data_of_the_model_leave_nothing_and_their_transient_is_no_error(drive, estimator):
    E, Z = spectra(drive, START, HandModel(), estimator)
    assert np.abs(E).max() < 1e-12
    # The equation of the module's head, written out: Y = Z + C (zI - A)^-1 z (x_0 - x_N).
    old, new = (w[START : START + N] for w in HandModel().acting_inputs(drive.u))
    for k, cycles in enumerate(estimator.cycles):
        w = np.exp(-2j * np.pi * cycles * np.arange(N) / N) * (2.0 if cycles else 1.0) / N
        acting = B_OLD @ (w @ old) + B_NEW @ (w @ new)
        driven = C @ np.linalg.solve(np.exp(2j * np.pi * cycles / N) * np.eye(3) - A, acting)
        np.testing.assert_allclose(Z[k], driven + (0.0 if cycles else OUTPUT_OFFSET), atol=1e-12)
    Y = lines(drive.y[START : START + N], estimator)
    assert np.abs(Y - Z)[1:].max() > 1e-2, "a transient that matters"


def test_what_is_added_is_left_but_for_what_a_transient_could_be(drive, estimator):
    """The error is the residual of real least squares over the lines but DC; the same transient leaves DC."""
    n = np.arange(len(drive.v)) - START
    added = np.column_stack(
        [0.05 + 0.02 * np.cos(2 * np.pi * 5 * n / N), 0.03 * np.sin(2 * np.pi * 3 * n / N)]
    )
    E, Z = spectra(replace(drive, y=drive.y + added), START, HandModel(), estimator)
    D = lines(added[START : START + N], estimator)
    z, inverse = resolvent(A, estimator)
    T = np.stack([(2.0 if c else 1.0) / N * z[k] * C @ inverse[k] for k, c in enumerate(estimator.cycles)])
    over = T[1:].reshape(-1, 3)
    normal = (over.conj().T @ over).real
    gap = np.linalg.solve(normal, (over.conj().T @ D[1:].ravel()).real)
    np.testing.assert_allclose(E, D - T @ gap, atol=1e-12)
    np.testing.assert_allclose(Z, spectra(drive, START, HandModel(), estimator)[1], atol=1e-13)
    assert np.abs(gap).max() > 1e-3
