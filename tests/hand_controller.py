"""A controller made by hand for tests: reference model, feedforward by the DC gain, PI on the tracking error.

It stands in for a designed one wherever a test needs some stable scheduled controller in the form that `lpvguard design`
writes (tools/src/lpvguard/control_export.py).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from lpvguard.nominal import NominalModel
from lpvguard.project import Project

NODES = 5
PROPORTIONAL, INTEGRAL = 0.5, 0.5
ERROR_POLE, REFERENCE_POLE, LEAK = 10.0, 20.0, 0.02


def hand_controller(project: Project) -> dict:
    """The document of controller.json for a vehicle whose first output is the controlled one. A second input takes its
    share of the proportional part only, so that no row of C repeats another."""
    model = NominalModel(project)
    speeds = np.linspace(*model.speed_range, NODES)
    A_v, B_v = model.matrices(speeds)
    gain = -(model.C @ np.linalg.solve(A_v, B_v))[:, 0, :]
    # States: reference model (2), filtered error, its integral, filtered reference.
    A = np.array([[0.0, 1.0, 0.0, 0.0, 0.0],
                  [-9.0, -5.4, 0.0, 0.0, 0.0],
                  [ERROR_POLE, 0.0, -ERROR_POLE, 0.0, 0.0],
                  [0.0, 0.0, 1.0, -LEAK, 0.0],
                  [0.0, 0.0, 0.0, 0.0, -REFERENCE_POLE]])
    B = np.zeros((5, 1 + model.n_y))
    B[1, 0], B[2, 1], B[4, 0] = 9.0, -ERROR_POLE, REFERENCE_POLE
    hold = expm(np.block([[A, B], [np.zeros((B.shape[1], 5 + B.shape[1]))]]) * project.Ts_s)
    Ad, Bd = hold[:5, :5], hold[:5, 5:]
    share = np.array([[0.0, 0.0, PROPORTIONAL, INTEGRAL, 1.0], [0.0, 0.0, PROPORTIONAL, 0.0, 0.0]])[:model.n_u]
    C = share / gain[:, :, None]
    L, R = [], np.eye(model.n_u)
    for c in C:
        P = solve_discrete_are(Ad.T, c.T, np.eye(5) * project.Ts_s, R)
        L.append(Ad @ P @ c.T @ np.linalg.inv(c @ P @ c.T + R))
    return {"Ts_s": project.Ts_s, "speeds": speeds.tolist(),
            "A": np.repeat(Ad[None], NODES, axis=0).tolist(), "B": np.repeat(Bd[None], NODES, axis=0).tolist(),
            "C": C.tolist(), "L": np.array(L).tolist(), "u_max": [3.0] * model.n_u, "rate_max": [20.0] * model.n_u}
