"""Equation (1) of the paper at one frequency, and all signals that satisfy its second line, (4) to (7)."""

from dataclasses import dataclass

import numpy as np

from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block

RANK_TOLERANCE = 1e-10
"""Singular values below this fraction of the largest one count as zero, after scaling of the columns."""

IMAGE_TOLERANCE = 1e-8
"""e counts as in Im M if its part outside Im M is below this fraction of |e|."""


@dataclass(frozen=True)
class Lft:
    """Equation (1) of the paper at one frequency.

    Attributes
    ----------
    blocks : tuple of Block, with p rows and q columns in total
    p11 : ndarray (q, p) of complex
    p12 : ndarray (q, n_w) of complex
    p21 : ndarray (n_y, p) of complex
    p22 : ndarray (n_y, n_w) of complex
    eta0 : ndarray (q,) of complex
    e : ndarray (n_y,) of complex
    source : str, name of the point in errors

    Raises
    ------
    InputError
        If shapes do not fit or values are not finite. The error names ``source``.
    """

    blocks: tuple[Block, ...]
    p11: np.ndarray
    p12: np.ndarray
    p21: np.ndarray
    p22: np.ndarray
    eta0: np.ndarray
    e: np.ndarray
    source: str = "lft"

    def __post_init__(self) -> None:
        p, q = sum(b.rows for b in self.blocks), sum(b.cols for b in self.blocks)
        n_y, n_w = self.e.shape[0], self.p22.shape[-1]
        if not self.blocks or n_y == 0:
            raise InputError(self.source, "blocks, e", "empty", "at least one block and one output")
        shapes = {
            "p11": (q, p),
            "p12": (q, n_w),
            "p21": (n_y, p),
            "p22": (n_y, n_w),
            "eta0": (q,),
            "e": (n_y,),
        }
        for name, shape in shapes.items():
            a = getattr(self, name)
            if a.shape != shape:
                raise InputError(
                    self.source, name, f"shape {a.shape}", f"{shape} to fit the blocks, e and P22"
                )
            if not np.all(np.isfinite(a)):
                raise InputError(self.source, name, "a value that is not finite", "finite numbers")

    @property
    def matrices(self) -> dict[str, np.ndarray]:
        """The matrices by the argument names of :func:`delta.verify`."""
        return {"P11": self.p11, "P12": self.p12, "P21": self.p21, "P22": self.p22, "eta0": self.eta0}


@dataclass(frozen=True)
class Parametrisation:
    """All (xi, w) that satisfy (4): ``xi = xi_map @ z``, ``w = w_map @ z``, ``eta = eta_map @ z``.

    z = (phi, psi, 1) with ``n_phi`` entries in phi.

    ``b1`` is the right side of (9), the norm of the smallest disturbance, which phi = 0 attains.
    """

    xi_map: np.ndarray
    w_map: np.ndarray
    eta_map: np.ndarray
    n_phi: int
    b1: float


def parametrise(problem: Lft) -> Parametrisation:
    """Compute the SVD parametrisation (5) to (7).

    Raises InputError when e is not in Im M with M = [P21 P22], because no signals of this structure can
    produce it.

    The columns of M are first scaled to a common size. All of w gets one factor, so that |w| keeps its
    meaning. Without scaling, the units of a model could give M a condition number of 1e10.
    """
    m = np.hstack([problem.p21, problem.p22])
    p, norm_e = problem.p21.shape[1], np.linalg.norm(problem.e)
    scale = np.ones(m.shape[1])
    for columns in [
        *np.split(np.arange(p), np.cumsum([b.rows for b in problem.blocks])[:-1]),
        np.arange(p, m.shape[1]),
    ]:
        size = np.linalg.norm(m[:, columns])
        scale[columns] = 1.0 / size if size > 0.0 else 1.0
    u, s, vh = np.linalg.svd(m * scale)
    rank = int(np.sum(s > RANK_TOLERANCE * s[0]))
    outside = np.linalg.norm(u[:, rank:].conj().T @ problem.e)
    if outside > IMAGE_TOLERANCE * norm_e:
        raise InputError(
            problem.source,
            "e",
            f"not in Im [P21 P22]: {outside:.3g} of |e| = {norm_e:.3g} cannot be explained",
            "a structure that can produce e, for example P22 = I",
        )
    particular = scale * (vh[:rank].conj().T @ ((u[:, :rank].conj().T @ problem.e) / s[:rank]))
    null = scale[:, None] * vh[rank:].conj().T
    w_p, n_w = particular[p:], null[p:]
    u_w, s_w, vh_w = np.linalg.svd(n_w)
    # In scaled columns the null space is orthonormal. A part in w below the tolerance is therefore rounding,
    # even if it is the largest part.
    n_phi = int(np.sum(s_w > RANK_TOLERANCE * scale[-1]))
    u1, v1, v2 = u_w[:, :n_phi], vh_w[:n_phi].conj().T, vh_w[n_phi:].conj().T
    w_min = w_p - u1 @ (u1.conj().T @ w_p)
    per_phi = null[:p] @ (v1 / s_w[:n_phi])
    xi_0 = particular[:p] - per_phi @ (u1.conj().T @ w_p)
    xi_map = np.column_stack([per_phi, null[:p] @ v2, xi_0])
    w_map = np.column_stack([u1, np.zeros((n_w.shape[0], v2.shape[1])), w_min])
    eta_map = problem.p11 @ xi_map + problem.p12 @ w_map
    eta_map[:, -1] += problem.eta0
    return Parametrisation(xi_map, w_map, eta_map, n_phi, float(np.linalg.norm(w_min)))
