"""Model, weights and controller as objects of python-control. The module needs this package."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.optional import optional
from ..core.control_coefficients import read_controller
from ..core.scheduled import Scheduled
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project
from .identification import Identified, project_of

if TYPE_CHECKING:
    import control


def nominal(vehicle: str | Path | Project, speed_mps: float) -> control.StateSpace:
    """Return the nominal model at a constant speed as a discrete-time system with its delay.

    Its inputs and outputs have the units of the signal table, without offsets.

    Parameters
    ----------
    vehicle : str, Path or Project
    speed_mps : float, m/s

    Returns
    -------
    control.StateSpace

    Raises
    ------
    InputError
        If the speed is outside the model's range.
    """
    project = project_of(vehicle)
    model = NominalModel(project)
    model.require_speed(speed_mps)
    step = model.discretise(np.array([speed_mps]))
    n, m, held = model.n, model.n_u, model.delay + 1
    # The states are the model's states, then the inputs of the last delay + 1 samples, newest first.
    A = np.zeros((n + held * m, n + held * m))
    B = np.zeros((n + held * m, m))
    A[:n, :n] = step.Ad[0]
    A[:n, n + (held - 1) * m :] = step.B_old[0]
    if model.delay:
        A[:n, n + (held - 2) * m : n + (held - 1) * m] = step.B_new[0]
    else:
        B[:n] = step.B_new[0]
    B[n : n + m] = np.eye(m)
    A[n + m :, n : n + (held - 1) * m] = np.eye((held - 1) * m)
    C = np.hstack([model.C, np.zeros((model.n_y, held * m))])
    names = [[s.name for s in group] for group in (project.inputs, project.outputs)]
    return _control().ss(A, B, C, np.zeros((model.n_y, m)), model.Ts, inputs=names[0], outputs=names[1])


def weights(identified: Identified) -> dict[str, list[control.TransferFunction]]:
    """Return the certificate's W_delta and W_w as transfer functions of s [rad/s], with the final inflation.

    Parameters
    ----------
    identified : Identified

    Returns
    -------
    dict of list of TransferFunction, W_delta one per Delta, W_w one per output
    """
    scale, tf = identified.fitted.inflation, _control().tf
    return {
        name: [tf(scale * w.fit.weight.num, w.fit.weight.den) for w in fitted]
        for name, fitted in (("W_delta", identified.fitted.W_delta), ("W_w", identified.fitted.W_w))
    }


def controller(path: str | Path, speed_mps: float) -> control.StateSpace:
    """Return the controller of a controller.json at a constant speed in discrete time, as in the core.

    Its inputs are reference and measured outputs, and its outputs are the demands.

    Parameters
    ----------
    path : str or Path
    speed_mps : float, m/s

    Returns
    -------
    control.StateSpace

    Raises
    ------
    InputError
        If the file is not a sealed controller.
    """
    at = Scheduled.read(read_controller(Path(path))).at(speed_mps)
    return _control().ss(at.A, at.B, at.C, at.D, at.dt)


def _control() -> Any:
    return optional("control", "control")
