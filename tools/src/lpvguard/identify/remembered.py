"""Memory of filters at a restart: the norm of their response to earlier inputs (THEORY 7.2).

A filter had the input x up to a restart, and its response x0 to this past continues. The module computes the
least m with

    || x0 || (T) <= rho^(T - t0 + 1) m    at every T >= t0,

where t0 is the first sample after the restart. The energy before t0 is a sum with forgetting. The energy from
t0 on is a quadratic form in the state of the filter, and a discrete Lyapunov equation gives it exactly.
"""

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import lfilter, sosfilt


def section_states(sections: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States (2 S, N) of second-order sections (S, 6) in z before each sample, and the output (N,).

    The input is x (N,), from rest. The states are those of `scipy.signal.sosfilt`, direct form II transposed.
    """
    states = np.zeros((len(sections), 2, len(x)))
    for state, section in zip(states, sections, strict=True):
        b, a = section[:3], section[3:]
        y = sosfilt(section[None], x)
        second = b[2] * x - a[2] * y
        state[1, 1:] = second[:-1]
        state[0, 1:] = (b[1] * x - a[1] * y + state[1])[:-1]
        x = y
    return states.reshape(-1, states.shape[-1]), x


def free_response(sections: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrices A (2 S, 2 S) and C (2 S,) of the free response: the state s becomes A s, the output is C s."""
    unit = np.eye(2 * len(sections)).reshape(-1, len(sections), 2)
    response, after = zip(*(sosfilt(sections, [0.0], zi=state) for state in unit), strict=True)
    return np.array(after).reshape(len(unit), -1).T, np.concatenate(response)


def response_energy(sections: np.ndarray, rho: float, settle: int = 0) -> np.ndarray:
    """Quadratic form (2 S, 2 S) in the state for the weighted energy of the free response of sections (S, 6).

    The square of the output after n further samples is divided by rho^(2 (n + 1)). The first ``settle``
    samples do not count. The poles must lie below ``rho``.
    """
    A, C = free_response(sections)
    power = np.linalg.matrix_power(A / rho, settle)
    return power.T @ solve_discrete_lyapunov((A / rho).T, np.outer(C, C)) @ power / rho**2


def remembered(sections: np.ndarray, x: np.ndarray, rho: float, settle: int | None = None) -> float:
    """Largest m over restarts before each sample of the input x (N,) of sections (S, 6), from rest.

    Their poles must lie below ``rho``, the forgetting factor per sample. The sum begins ``settle`` samples
    after the restart. With None it also includes the output before the restart.
    """
    states, y = section_states(sections, x)
    energy = np.einsum("in,ij,jn->n", states, response_energy(sections, rho, settle or 0), states)
    if settle is None:
        energy += lfilter([0.0, 1.0], [1.0, -(rho**2)], y**2)
    return float(np.sqrt(max(energy.max(), 0.0)))
