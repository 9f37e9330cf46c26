"""Continuous generalised plant in blocks, for the Riccati equations, and the test for a stabilising
controller.

A discrete plant is replaced by its bilinear image, after a feedback that removes poles at z = −1. D22 is left
out of the plant and is considered in the controller afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.statespace import EPS, StateSpace


@dataclass(frozen=True)
class Plant:
    """The continuous generalised plant x' = A x + B1 w + B2 u, z = C1 x + D11 w + D12 u, y = C2 x + D21 w.

    A (n, n), B1 (n, m1), B2 (n, m2), C1 (p1, n), C2 (p2, n), D11 (p1, m1), D12 (p1, m2), D21 (p2, m1). D22 is
    zero; ``absorb_feedthrough`` changes the controller to one for a plant with D22.
    """

    A: np.ndarray
    B1: np.ndarray
    B2: np.ndarray
    C1: np.ndarray
    C2: np.ndarray
    D11: np.ndarray
    D12: np.ndarray
    D21: np.ndarray

    @property
    def dual(self) -> Plant:
        """The transposed plant. Its control side is the filter side of this plant."""
        return Plant(self.A.T, self.C1.T, self.C2.T, self.B1.T, self.B2.T, self.D11.T, self.D21.T, self.D12.T)


def check_shape(plant: StateSpace, n_control: int, n_measurement: int) -> None:
    """Raise SynthesisError unless w and z have at least one signal each."""
    for name, count, available, kind in (
        ("n_control", n_control, plant.n_inputs, "inputs"),
        ("n_measurement", n_measurement, plant.n_outputs, "outputs"),
    ):
        if not (isinstance(count, (int, np.integer)) and 1 <= count < available):
            raise SynthesisError(
                "generalised plant",
                name,
                f"{count}",
                f"a whole number from 1 to {available - 1}, because the plant has {available} {kind}",
            )


def move_pole_at_minus_one(
    plant: StateSpace, n_control: int, n_measurement: int
) -> tuple[np.ndarray, StateSpace]:
    """A static feedback u = K0 y + ũ that removes poles at z = −1: K0 (m2, p2) and the plant closed with it.

    K0 is zero where there is no such pole, and for every continuous plant.
    """
    shift = np.zeros((n_control, n_measurement))
    if not plant.dt or plant.order == 0 or np.abs(plant.poles() + 1).min() > 1e-6:
        return shift, plant
    B2, C2, D = plant.B[:, -n_control:], plant.C[-n_measurement:], plant.D
    rng = np.random.default_rng(0)
    size = 0.1 * (1 + np.linalg.norm(plant.A, 2)) / (EPS + np.linalg.norm(B2, 2) * np.linalg.norm(C2, 2))
    shift = size * rng.standard_normal(shift.shape)
    S = np.linalg.inv(np.eye(n_measurement) - D[-n_measurement:, -n_control:] @ shift)
    inject, rows = shift @ S, slice(-n_measurement, None)
    cols = slice(-n_control, None)
    A = plant.A + B2 @ inject @ C2
    B = plant.B + B2 @ inject @ D[rows]
    C = plant.C + D[:, cols] @ inject @ C2
    return shift, StateSpace(A, B, C, D + D[:, cols] @ inject @ D[rows], plant.dt)


def partition(plant: StateSpace, n_u: int, n_y: int) -> tuple[Plant, np.ndarray]:
    """Blocks of a plant, and D22 (n_y, n_u). The last inputs are u (n_u,), the last outputs y (n_y,)."""
    w, u = slice(0, plant.n_inputs - n_u), slice(plant.n_inputs - n_u, None)
    z, y = slice(0, plant.n_outputs - n_y), slice(plant.n_outputs - n_y, None)
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    return Plant(A, B[:, w], B[:, u], C[z], C[y], D[z, w], D[z, u], D[y, w]), D[y, u]


def absorb_feedthrough(K: StateSpace, D22: np.ndarray) -> StateSpace:
    """Controller K (I + D22 K)⁻¹ for the plant with D22, from K for the plant without D22."""
    if not np.any(D22):
        return K
    S = np.linalg.inv(np.eye(D22.shape[0]) + D22 @ K.D)
    return StateSpace(K.A - K.B @ S @ D22 @ K.C, K.B @ S, K.C - K.D @ S @ D22 @ K.C, K.D @ S)


def check_existence(P: Plant, plant: StateSpace) -> None:
    """Popov–Belevitch–Hautus test of (A, B2) and (C2, A) at every pole that is not strictly stable.

    Raises SynthesisError with the pole of the given ``plant`` and the missing property.
    """
    if P.A.size == 0:
        return
    scale = float(np.linalg.norm(P.A, 2)) or 1.0
    for A, B, what, missing, change in (
        (P.A, P.B2, "(A, B2) is not stabilisable", "the control inputs do not reach", "an actuator for it"),
        (P.A.T, P.C2.T, "(C2, A) is not detectable", "the measurements do not show", "a sensor for it"),
    ):
        unit = scale * B / max(float(np.linalg.norm(B, 2)), 1e-300)
        for pole in np.linalg.eigvals(A):
            if pole.real < -1e-12 * scale:
                continue
            sigma = np.linalg.svd(np.hstack([A - pole * np.eye(len(A)), unit]), compute_uv=False)[-1]
            if sigma < 1e-11 * scale:
                shown = _to_point(pole, plant)
                raise SynthesisError(
                    "generalised plant",
                    what,
                    f"{missing} the pole at {shown:.6g}",
                    f"{change}, or a plant without this mode (a slow lag in place of an integrating weight)",
                )


def _to_point(pole: complex, plant: StateSpace) -> complex:
    """Pole of ``plant`` (in the z-plane for a discrete one) from the pole of its continuous image."""
    return (2 / plant.dt + pole) / (2 / plant.dt - pole) if plant.dt else pole
