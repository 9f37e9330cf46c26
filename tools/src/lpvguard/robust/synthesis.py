"""H-infinity and mu synthesis with certified levels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import InputError
from ..engine.blocks import Block
from ..engine.synthesis.dk import dk_synthesis
from ..engine.synthesis.hinf import hinf_synthesis, proved_lower_bound
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.statespace import StateSpace, lft
from .systems import as_control, state_space

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class Synthesis:
    """A controller and its proved properties.

    Attributes
    ----------
    K : control.StateSpace
        Controller u = K y.
    CL : control.StateSpace
        Closed loop from the remaining inputs to the remaining outputs.
    level : float
        Proved upper bound of the H-infinity norm of ``CL``, or of mu at every frequency.
    lower : float
        For ``hinfsyn``, a lower bound of the level of every controller. For ``musyn``, a lower bound of mu of
        this loop.
    peak : float
        Frequency of the largest value, in rad/s.
    notes : tuple of str
        Special events, for example that a singular problem was regularised.
    """

    K: control.StateSpace
    CL: control.StateSpace
    level: float
    lower: float
    peak: float
    notes: tuple[str, ...] = ()


def hinfsyn(P: Any, nmeas: int, ncon: int, backoff: float = 1e-3) -> Synthesis:
    """Compute an H-infinity controller and certify its level.

    Parameters
    ----------
    P : control.StateSpace or control.TransferFunction
        Generalised plant. The last ``ncon`` inputs are the controls, the last ``nmeas`` outputs the
        measurements. Continuous or discrete; singular problems are allowed.
    nmeas, ncon : int
        Numbers of measurements and controls.
    backoff : float
        Relative amount by which the level may exceed the optimum, because optimal controllers can have
        infinite poles.

    Raises
    ------
    SynthesisError
        No stabilising controller exists, or the data are not precise enough to determine the optimum.

    References
    ----------
    lib/THEORY.md 6.1; Doyle, Glover, Khargonekar and Francis 1989.
    """
    plant = _plant(P, nmeas, ncon)
    result = hinf_synthesis(plant, ncon, nmeas, backoff)
    lower = proved_lower_bound(plant, ncon, nmeas, result.gamma).value
    return Synthesis(
        as_control(result.controller),
        as_control(lft(plant, result.controller)),
        result.gamma_achieved,
        lower,
        result.certificate.peak_frequency,
        result.notes,
    )


def musyn(
    P: Any, nmeas: int, ncon: int, blocks: Sequence[Block], degree: int = 1, iterations: int = 4
) -> Synthesis:
    """Compute a controller for robust performance by D-K iteration and certify its level of mu.

    Parameters
    ----------
    P : control.StateSpace or control.TransferFunction
        Generalised plant. Inputs: Delta's outputs, disturbances, controls. Outputs: Delta's inputs, errors,
        measurements.
    nmeas, ncon : int
        Numbers of measurements and controls.
    blocks : sequence of Block
        Full blocks of Delta, in the order of the signals.
    degree : int
        Order of the scaling of each block.
    iterations : int
        Number of D-K steps, at least 1.

    Raises
    ------
    InputError
        A number is out of range, or the blocks are larger than the plant.
    SynthesisError
        As ``hinfsyn``, or a block is not full.

    References
    ----------
    lib/THEORY.md 6.4; Packard and Doyle 1993.
    """
    plant = _plant(P, nmeas, ncon)
    for name, value, least in (("degree", degree, 0), ("iterations", iterations, 1)):
        if value < least:
            raise InputError("musyn", name, str(value), f"at least {least}")
    rows, cols = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    if rows >= plant.n_inputs - ncon or cols >= plant.n_outputs - nmeas:
        raise InputError(
            "musyn",
            "blocks",
            f"{rows} x {cols} in total",
            f"less than {plant.n_inputs - ncon} x {plant.n_outputs - nmeas}, so that w and z remain",
        )
    posed = GeneralisedPlant(plant, tuple(blocks), rows, cols, ncon, nmeas)
    result = dk_synthesis(posed, degree=degree, iterations=iterations)
    proved = result.performance
    return Synthesis(
        as_control(result.controller),
        as_control(lft(plant, result.controller)),
        proved.upper,
        proved.lower,
        proved.bracket.peak_frequency,
    )


def _plant(P: Any, nmeas: int, ncon: int) -> StateSpace:
    """Convert the plant to the engine's form and check the numbers of signals."""
    plant = state_space(P, "P")
    for name, value, most in (("nmeas", nmeas, plant.n_outputs), ("ncon", ncon, plant.n_inputs)):
        if not (isinstance(value, (int, np.integer)) and 1 <= value < most):
            raise InputError("P", name, str(value), f"an integer from 1 to {most - 1}")
    return plant
