"""Index sets of M for the blocks of Δ, and bases of the scalings that commute with these blocks."""

import itertools

import numpy as np

from lpvguard.engine.blocks import Block


class Structure:
    """Index sets of M for the blocks of Δ: rows (inputs of Δ) and columns (outputs of Δ).

    It also holds real bases of the D and G scalings of the blocks.
    """

    def __init__(self, blocks: tuple[Block, ...]):
        self.blocks = blocks
        rows = np.cumsum([0] + [b.cols for b in blocks])
        cols = np.cumsum([0] + [b.rows for b in blocks])
        self.row = [slice(a, b) for a, b in itertools.pairwise(rows)]
        self.col = [slice(a, b) for a, b in itertools.pairwise(cols)]
        self.n_rows, self.n_cols = int(rows[-1]), int(cols[-1])
        left, right, skew = [], [], []
        for b, r, c in zip(blocks, self.row, self.col, strict=True):
            for E in [None] if b.kind == "full" else _hermitian_basis(b.rows):
                EL, ER = np.zeros((self.n_rows,) * 2, complex), np.zeros((self.n_cols,) * 2, complex)
                EL[r, r] = np.eye(b.cols) if E is None else E
                ER[c, c] = np.eye(b.rows) if E is None else E
                left.append(EL)
                right.append(ER)
            if b.kind == "repeated_real":
                for E in _hermitian_basis(b.rows):
                    G = np.zeros((self.n_cols, self.n_rows), complex)
                    G[c, r] = E
                    skew.append(G)
        self.left, self.right = np.array(left), np.array(right)
        self.skew = np.array(skew) if skew else np.zeros((0, self.n_cols, self.n_rows), complex)
        self.complex_only = all(b.kind != "repeated_real" for b in blocks)

    def coordinates(self, D: np.ndarray, G: np.ndarray) -> np.ndarray:
        """Coefficients of ``D`` (n_cols, n_cols) and ``G`` (n_cols, n_rows) in the bases of the blocks.

        The bases are ``right`` and ``skew``. The coefficients form one real vector (len(right) + len(skew),)
        that begins with those of D. The bases are orthogonal.
        """
        parts = [
            np.real(np.sum(basis.conj() * value, axis=(1, 2))) / np.sum(np.abs(basis) ** 2, axis=(1, 2))
            for basis, value in ((self.right, D), (self.skew, G))
        ]
        return np.concatenate(parts)

    def magnitude(self, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """|G| = (G²)^½ of the blocks of G (n_cols, n_rows).

        Returns D_left (n_rows, n_rows) and D_right (n_cols, n_cols) with these blocks.
        """
        left, right = np.zeros((self.n_rows,) * 2, complex), np.zeros((self.n_cols,) * 2, complex)
        for b, r, c in zip(self.blocks, self.row, self.col, strict=True):
            if b.kind == "repeated_real":
                values, vectors = np.linalg.eigh(G[c, r])
                left[r, r] = right[c, c] = vectors * np.abs(values) @ vectors.conj().T
        return left, right


def _hermitian_basis(n: int) -> list[np.ndarray]:
    out = []
    for i in range(n):
        for j in range(i, n):
            E = np.zeros((n, n), complex)
            E[i, j] = E[j, i] = 1
            out.append(E)
            if j > i:
                E = np.zeros((n, n), complex)
                E[i, j], E[j, i] = 1j, -1j
                out.append(E)
    return out
