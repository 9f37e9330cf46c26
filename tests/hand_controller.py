"""A controller made by hand for tests: reference model, feedforward by the DC gain, PI on the tracking error.

It stands in for a designed one wherever a test needs some stable scheduled controller in the form that
`lpvguard design` writes (tools/src/lpvguard/core/control_coefficients.py).
"""

import numpy as np
from scipy.linalg import solve_discrete_are

from lpvguard.core.scheduled import realisation
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import Project

NODES = 5
PROPORTIONAL, INTEGRAL = 0.5, 0.5
ERROR_POLE, REFERENCE_POLE, LEAK = 10.0, 20.0, 0.02


def hand_controller(project: Project, *, single: bool = True) -> dict:
    """The document of controller.json for a vehicle whose first output is the controlled one. A second input
    takes its share of the proportional part only. Not ``single``: without the last state, so that their
    number is even."""
    model, Ts = NominalModel(project), project.Ts_s
    speeds = np.linspace(*model.speed_range, NODES)
    A_v, B_v = model.matrices(speeds)
    gain = -(model.C @ np.linalg.solve(A_v, B_v))[:, 0, :]
    # Pairs: reference model 9 / (s^2 + 5.4 s + 9), filter and leaky integral of the error; single: filtered
    # reference.
    pairs = [np.exp(Ts * np.roots([1.0, 5.4, 9.0])) - 1, np.exp(-Ts * np.array([ERROR_POLE, LEAK])) - 1]
    delay = np.exp(-Ts * REFERENCE_POLE) - 1
    a = np.append(np.array([[p.sum().real, -p.prod().real] for p in pairs]).ravel(), delay)
    # Numerators h d + t over d = z - 1: of the model (for the error's reference), of PI on the error, of the
    # reference.
    shares = np.array([[PROPORTIONAL, INTEGRAL], [PROPORTIONAL, 0.0]])[: model.n_u]
    B = np.zeros((NODES, model.n_u, 5, 1 + model.n_y))
    for i, (proportional, integral) in enumerate(shares):
        error = np.array(
            [Ts * ERROR_POLE * proportional, Ts * ERROR_POLE * Ts * (integral + LEAK * proportional)]
        )
        B[:, i, 1, 0] = -a[1] * proportional
        B[:, i, 2:4, 1] = -error
        B[:, i, 2:4, 0] = error
        B[:, i, 4, 0] = -delay
    B /= gain[:, :, None, None]
    if not single:
        a, B = a[:4], B[:, :, :4]
    A, c = realisation(a)
    # The stationary Kalman gain for m like white noise, which trusts u more than the model of it.
    L1 = []
    for rows in B[NODES // 2]:
        Q = rows @ rows.T
        P = solve_discrete_are(A.T, c.T, Q + 1e-9 * np.diag(np.diag(Q)), 0.1 * c @ Q @ c.T)
        L1.append(A @ P @ c.T / (c @ P @ c.T + 0.1 * c @ Q @ c.T))
    L = np.zeros((NODES, model.n_u, len(a), model.n_u))
    for i in range(model.n_u):
        L[:, i, :, i] = L1[i][:, 0]
    return {
        "Ts_s": Ts,
        "speeds": speeds.tolist(),
        "a": a.tolist(),
        "B": B.tolist(),
        "L": L.tolist(),
        "u_max": (np.array([3.0, 2.5])[: model.n_u] * (speeds[0] / speeds[:, None]) ** 0.25).tolist(),
        "rate_max": [20.0] * model.n_u,
    }
