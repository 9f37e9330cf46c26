"""Check well-posedness: I - P11 Delta must be regular for every Delta of a given structure and size."""

import numpy as np

from lpvguard.engine.validation import lmi
from lpvguard.engine.validation.delta import split
from lpvguard.engine.validation.problem import Lft


def block_caps(problem: Lft) -> np.ndarray:
    """Caps (tau,) 1 / sigma_max(P11,ii). At this size a single full block can make I - P11 Delta singular.

    A cap is inf where P11,ii = 0.
    """
    caps = []
    row = col = 0
    for b in problem.blocks:
        gain = np.linalg.norm(problem.p11[row : row + b.cols, col : col + b.rows], 2)
        caps.append(1.0 / gain if gain > 0.0 else np.inf)
        row, col = row + b.cols, col + b.rows
    return np.array(caps)


def well_posed(problem: Lft, nu: np.ndarray) -> bool:
    """Certify that no Delta with ||Delta_i|| <= nu_i makes I - P11 Delta singular; ``nu`` (tau,).

    The first test uses the spectral radius of the matrix of block norms. The second is the S-procedure on
    ``|xi_i| <= nu_i |(P11 xi)_i|`` with the multipliers of each block's structure. A repeated scalar has a
    matrix multiplier, and a real one has a second matrix (the D-G scalings of mu).
    """
    etas = split(problem.blocks, problem.p11, "cols")
    norms = np.array(
        [[np.linalg.norm(part.T, 2) for part in split(problem.blocks, eta.T, "rows")] for eta in etas]
    )
    if np.max(np.abs(np.linalg.eigvals(norms * nu))) < 1.0:
        return True
    live = [i for i, b in enumerate(nu) if b > 0.0]
    xi = split(problem.blocks, np.eye(problem.p11.shape[1], dtype=complex), "rows")
    keep = np.concatenate([np.argmax(np.abs(xi[i]), axis=1) for i in live])
    stacked: list[np.ndarray] = []
    groups: list[tuple[str, int]] = []
    for i in live:
        block = problem.blocks[i]
        basis = lmi.hermitian_basis(block.rows) if block.repeated else None
        a, b = xi[i][:, keep], nu[i] * etas[i][:, keep]
        pieces = [("psd", lmi.gram(a, a, basis) - lmi.gram(b, b, basis))]
        if block.kind == "repeated_real":
            cross = 1j * lmi.gram(a, b, basis)
            pieces.append(("free", cross + cross.conj().transpose(0, 2, 1)))
        for kind, piece in pieces:
            stacked.extend(piece / (np.max(np.abs(piece)) or 1.0))
            groups.append((kind, block.rows if block.repeated else 1))
    forms = np.array(stacked)
    level = lmi.maximise_level(forms, lmi.cone(groups), absolute=1e-10)
    return level.x > lmi.rounding(level.y, forms)
