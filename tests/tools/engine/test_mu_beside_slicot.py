"""Bounds of μ beside those of SLICOT's AB13MD (Fan, Tits & Doyle's D, G bound), where slycot is installed,
and beside the printed bound of its example."""

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.mu import mu_bounds

ROWS = (
    [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
    [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
    [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
)


def test_the_example_in_the_documentation_of_ab13md_has_the_bound_printed_there():
    """SLICOT prints 41.74753408 for two real scalars, a full 2 x 2 and two complex scalars."""
    blocks = [
        Block(kind, n, n)
        for kind, n in (("repeated_real", 1), ("repeated_real", 1), ("full", 2), ("full", 1), ("full", 1))
    ]
    bounds = mu_bounds(np.array(ROWS + ROWS), blocks)
    assert bounds.lower <= 41.74753408 * (1 + 1e-8)
    assert bounds.upper <= 41.74753408 * (1 + 1e-3)


@pytest.mark.unhurried
@pytest.mark.parametrize("seed", range(12))
def test_no_bound_is_above_slicots_nor_its_bound_below_ours(seed):
    """Both hold for the same M; ours is at most 0.1 % above theirs, and no Δ of ours refutes theirs."""
    slycot = pytest.importorskip("slycot", reason="slycot (SLICOT's AB13MD) is not installed")
    random = np.random.default_rng(seed)
    kinds = random.integers(1, 3, random.integers(1, 5))
    sizes = np.where(kinds == 1, 1, random.integers(1, 3, len(kinds)))
    blocks = [
        Block("repeated_real" if kind == 1 else "full", int(size), int(size))
        for kind, size in zip(kinds, sizes, strict=True)
    ]
    n = int(sizes.sum())
    M = random.standard_normal((n, n)) + 1j * random.standard_normal((n, n)) * (seed % 3 > 0)
    theirs, *_ = slycot.ab13md(M, sizes, kinds)
    bounds = mu_bounds(M, blocks)
    if n == 1 and kinds[0] == 1:  # AB13MD answers 0 for a real scalar, as its documentation says
        assert bounds.upper == pytest.approx(abs(M[0, 0]) if M[0, 0].imag == 0 else 0.0, abs=1e-5)
        return
    assert bounds.upper <= theirs * 1.001
    assert bounds.lower <= theirs * (1 + 1e-6)
