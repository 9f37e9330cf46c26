"""Convert systems between python-control and the engine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import InputError
from ..base.optional import optional
from ..engine.synthesis.statespace import StateSpace

if TYPE_CHECKING:
    import control


def state_space(system: Any, name: str) -> StateSpace:
    """Convert a linear system to the engine's state space.

    Parameters
    ----------
    system : control.StateSpace or control.TransferFunction
        Continuous-time, or discrete-time with a stated sampling time.
    name : str
        Name of the argument, for messages.

    Raises
    ------
    InputError
        The object is not a linear system, or its sampling time is not stated.
    """
    package = python_control()
    if isinstance(system, package.TransferFunction):
        system = package.ss(system)
    if not isinstance(system, package.StateSpace):
        raise InputError(
            name, "", f"a {type(system).__name__}", "a StateSpace or TransferFunction of python-control"
        )
    if system.dt is True:
        raise InputError(name, "dt", "discrete without a sampling time", "the sampling time in seconds")
    return StateSpace(system.A, system.B, system.C, system.D, float(system.dt or 0.0))


def as_control(system: StateSpace) -> control.StateSpace:
    """Convert the engine's state space to python-control's."""
    return python_control().ss(system.A, system.B, system.C, system.D, system.dt)


def python_control() -> Any:
    """Import the package python-control; InputError names the extra that installs it."""
    return optional("control", "control")


def frequencies(omega: Any) -> np.ndarray:
    """Return ``omega`` (k,) in rad/s as an array; InputError unless it is positive, finite and increasing."""
    omega = np.asarray(omega, dtype=float)
    if (
        omega.ndim != 1
        or len(omega) == 0
        or not np.isfinite(omega).all()
        or omega[0] <= 0
        or (np.diff(omega) <= 0).any()
    ):
        raise InputError(
            "omega", "", f"shape {omega.shape}", "a list of increasing, finite frequencies above 0 rad/s"
        )
    return omega
