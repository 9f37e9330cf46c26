"""Analysis of given systems: structured singular value, worst-case gain, margins and nu-gap."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..engine.blocks import Block
from ..engine.synthesis import margins
from ..engine.synthesis import nu_gap as gap
from ..engine.synthesis import worst_gain as gain
from ..engine.synthesis.frequency_cells import IntervalBound
from ..engine.synthesis.margins import LoopMargins
from ..engine.synthesis.mu import MuBounds, mu_bounds, mu_interval
from ..engine.synthesis.norms import NormBracket
from .systems import state_space


def mu(M: Any, blocks: Sequence[Block], omega: tuple[float, float] = (0.0, np.inf)) -> MuBounds:
    """Compute an upper and a lower bound of the structured singular value.

    Parameters
    ----------
    M : array_like, control.StateSpace or control.TransferFunction
        Matrix of shape (sum of cols, sum of rows), or a stable loop of that shape.
    blocks : sequence of Block
        Blocks of Delta: full, repeated_complex or repeated_real.
    omega : tuple of float
        For a loop, the interval of frequencies in rad/s. A discrete loop ends at pi / dt at the latest.

    Returns
    -------
    MuBounds
        ``upper`` is proved at every frequency. ``lower`` is attained by ``delta`` at ``omega``.

    Raises
    ------
    SynthesisError
        The loop is unstable, its shape does not fit the blocks, or no bound could be proved.

    References
    ----------
    lib/THEORY.md 6.2.
    """
    if isinstance(M, (np.ndarray, list, tuple, float, complex, int)):
        return mu_bounds(np.atleast_2d(np.asarray(M, dtype=complex)), blocks)
    loop = state_space(M, "M")
    high = min(omega[1], np.pi / loop.dt) if loop.dt else omega[1]
    return mu_interval(loop, blocks, omega[0], high)


def worst_gain(
    loop: Any, blocks: Sequence[Block], performance: Block, omega: tuple[float, float] = (0.0, np.inf)
) -> IntervalBound:
    """Bound the worst-case gain from the last inputs to the last outputs over every Delta of size 1.

    Parameters
    ----------
    loop : control.StateSpace or control.TransferFunction
        Stable. The first outputs and inputs belong to Delta.
    blocks : sequence of Block
        Blocks of Delta.
    performance : Block
        Full block whose cols are the last outputs and whose rows are the last inputs.
    omega : tuple of float
        Interval of frequencies in rad/s.

    Raises
    ------
    SynthesisError
        As ``mu``.

    References
    ----------
    lib/THEORY.md 7.10.
    """
    system = state_space(loop, "loop")
    high = min(omega[1], np.pi / system.dt) if system.dt else omega[1]
    return gain.worst_gain(system, blocks, performance, omega[0], high)


def disk_margin(L: Any) -> LoopMargins:
    """Compute gain, phase, delay and disk margins of a loop with negative feedback.

    Parameters
    ----------
    L : control.StateSpace or control.TransferFunction
        Stable open loop with one input and one output.

    Raises
    ------
    SynthesisError
        The loop has several inputs or outputs, or unstable poles.

    References
    ----------
    lib/THEORY.md 7.4; Seiler, Packard and Gahinet 2020.
    """
    response, grid = margins.of_system(state_space(L, "L"))
    return margins.margins(response, grid)


def nu_gap(first: Any, second: Any) -> NormBracket:
    """Compute a lower and an upper bound of the nu-gap of two plants.

    Parameters
    ----------
    first, second : control.StateSpace or control.TransferFunction
        Both have the same shape and sampling time.

    References
    ----------
    lib/THEORY.md 7.11; Vinnicombe 1993.
    """
    return gap.nu_gap(state_space(first, "first"), state_space(second, "second"))
