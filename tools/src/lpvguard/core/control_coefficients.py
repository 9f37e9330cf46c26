"""Stage 6, export of a controller: write the sources for controller.h, bus.h and ecu.h of the core.

    lpvguard_control.c          the controller's coefficients
    lpvguard_bus.c              messages and signals of the CAN catalogue that carry the vehicle's signals
    lpvg_can_codec.h, .c        the codec of the whole catalogue
    further files               of a loop on the car's own bus: can/own_loop.py

Reads   controller.json, written by `lpvguard design`:
            Ts_s                        sample period [s]
            speeds (NG,)                nodes [m/s], equally spaced over the project's speed range
            a (NK,)                     poles of every demand's states, as in scheduled.py and controller.h
            B (NG, NU, NK, NM)          numerators; measurements: reference, then outputs
            L (NG, NU, NK, NU)          anti-windup injection, A - L C stable at every node and between
            u_max (NG, NU)              largest |demand| [input unit]
            rate_max (NU,)              its largest change [input unit/s]

The manifest of the generated folder holds the hash of controller.json.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..base.layout import COEFF, CONTROL
from ..can.bus import bus_source, sends_demand
from ..can.codegen import codec_files
from ..can.own_loop import loop_files
from ..vehicle.project import Project
from .scheduled import Scheduled, engagement
from .seal import Sealed, coefficient_source

CONTROL_SIZES = tuple(name for name in CONTROL.dimensions if name not in COEFF.dimensions)
"""Sizes in lpvguard_vehicle.h: states per demand, measurements, nodes; zero without a controller."""
MAX_STATES = 40
"""Largest number of states of all demands together."""
ARRAYS = ("speeds", "a", "B", "L", "u_max", "rate_max")


@dataclass(frozen=True)
class ControllerCoefficients(Sealed):
    """Coefficients of a gain-scheduled controller in the core's form.

    Attributes
    ----------
    Ts_s : float, s
    speeds : ndarray (NG,), m/s
    origin : dict[str, Any], hash of the controller's file, for the manifest
    """

    LAYOUT = CONTROL
    Ts_s: float
    speeds: np.ndarray
    origin: dict[str, Any]

    def manifest(self) -> dict[str, Any]:
        """Entry of the controller in the generated folder's manifest."""
        return {
            "sizes": self.sizes,
            "Ts_s": self.Ts_s,
            "speeds": self.speeds,
            "crc32": self.crc32_by_type(),
            "u_max": self.reals["u_max"],
            "rate_max": self.reals["rate_max"],
            **self.origin,
        }


def build_controller(
    Ts_s: float,
    speeds: np.ndarray,
    a: np.ndarray,
    B: np.ndarray,
    L: np.ndarray,
    u_max: np.ndarray,
    rate_max: np.ndarray,
    *,
    origin: dict[str, Any] | None = None,
    where: object = "controller",
) -> ControllerCoefficients:
    """Check a gain-scheduled controller and build its coefficients.

    Parameters
    ----------
    Ts_s : float, s
    speeds : ndarray (NG,), m/s, equally spaced
    a : ndarray (NK,), poles of each demand's states
    B : ndarray (NG, NU, NK, NM), numerators
    L : ndarray (NG, NU, NK, NU), anti-windup injection
    u_max : ndarray (NG, NU), largest |demand| [input unit]
    rate_max : ndarray (NU,), input unit/s
    origin : dict, optional, goes into the manifest
    where : object, name of the controller in errors, default 'controller'

    Returns
    -------
    ControllerCoefficients

    Raises
    ------
    InputError
        If an array does not fit; the error names ``where``, the array and the reason.
    """
    arrays = {
        key: np.asarray(value, float)
        for key, value in zip(ARRAYS, (speeds, a, B, L, u_max, rate_max), strict=False)
    }
    speeds, a, B, L, u_max, rate_max = arrays.values()
    _check(where, Ts_s, arrays)
    try:
        engage = engagement(a, B)
    except np.linalg.LinAlgError as error:
        raise InputError(where, "a", str(error), "stable poles") from None
    sizes = dict(zip(CONTROL_SIZES, (len(a), B.shape[3], len(speeds)), strict=False))
    words = {**CONTROL.head(sizes | {"NU": len(rate_max)}), "sample_period_us": round(Ts_s * 1e6)}
    reals = {
        "speed_min": speeds[0],
        "speed_max": speeds[-1],
        "u_max": u_max,
        "rate_max": rate_max,
        "A1": a,
        "engage": engage,
        "BL": np.concatenate([B, L], axis=3),
    }
    return ControllerCoefficients(sizes, words, reals, Ts_s, speeds, origin or {})


def replaced_controller(header: str, controller: ControllerCoefficients) -> dict[str, str]:
    """Return the files of a vehicle folder that depend on the controller.

    Parameters
    ----------
    header : str, text of lpvguard_vehicle.h so far
    controller : ControllerCoefficients

    Returns
    -------
    dict[str, str], text by file name
    """
    for name, value in controller.sizes.items():
        header = re.sub(rf"(#define LPVG_{name}) \d+", rf"\1 {value}", header)
    return {"lpvguard_vehicle.h": header, "lpvguard_control.c": coefficient_source(controller)}


def read_controller(path: Path) -> dict[str, Any]:
    """Read the document of a ``controller.json``.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict[str, Any]

    Raises
    ------
    InputError
        If the file is not sealed or not complete.
    """
    document = artefacts.read_json(path)
    if not isinstance(document, dict):
        raise InputError(path, "", "not an object", "controller.json as `lpvguard design` writes it")
    if "seal" in document:  # a hand-made controller has none
        artefacts.require_seal(path, document, "`lpvguard design`")
    missing = [key for key in ("Ts_s", *ARRAYS) if key not in document]
    if missing:
        raise InputError(path, ", ".join(missing), "missing", "as `lpvguard design` writes it")
    return document


def load_controller(path: Path) -> ControllerCoefficients:
    """Read and check a ``controller.json``; the module's docstring lists its content.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ControllerCoefficients

    Raises
    ------
    InputError
        If it is not sealed, not complete or not consistent.
    """
    document = read_controller(path)
    arrays = []
    for key in ARRAYS:
        try:
            arrays.append(np.array(document[key], float))
        except (TypeError, ValueError):
            raise InputError(path, key, "not an array of numbers", "nested lists of equal lengths") from None
    if not isinstance(document["Ts_s"], (int, float)):
        raise InputError(path, "Ts_s", repr(document["Ts_s"]), "a number of seconds")
    origin = {"sha256": artefacts.file_hash(path)}
    return build_controller(float(document["Ts_s"]), *arrays, origin=origin, where=path)


def _check(where: object, Ts_s: float, arrays: dict[str, np.ndarray]) -> None:
    """Raise InputError unless the arrays are finite, fit each other, and the anti-windup is stable."""

    def refuse(key: str, what: str, expected: str) -> None:
        raise InputError(where, key, what, expected)

    speeds, a, B = (arrays[key] for key in ("speeds", "a", "B"))
    if not (np.isfinite(Ts_s) and Ts_s > 0):
        refuse("Ts_s", f"{Ts_s!r}", "a positive number of seconds")
    if speeds.ndim != 1 or len(speeds) < 2 or not speeds[0] > 0:
        refuse("speeds", f"shape {speeds.shape}", "two or more positive speeds")
    if (
        not np.allclose(speeds, np.linspace(speeds[0], speeds[-1], len(speeds)), rtol=1e-9)
        or speeds[0] >= speeds[-1]
    ):
        refuse("speeds", f"{speeds.tolist()}", "ascending, equally spaced speeds")
    if a.ndim != 1 or B.ndim != 4:
        refuse(
            "a, B",
            f"of {a.ndim} and {B.ndim} dimensions",
            "one (states) and four (speeds, demands, states, measurements)",
        )
    n_g, n_u, n_k, n_m = len(speeds), B.shape[1], len(a), B.shape[3]
    if not 1 <= n_u * n_k <= MAX_STATES:
        refuse("a", f"{n_u * n_k} states", f"1 to {MAX_STATES} of all demands")
    shapes = {"B": (n_g, n_u, n_k, n_m), "L": (n_g, n_u, n_k, n_u), "u_max": (n_g, n_u), "rate_max": (n_u,)}
    for key, shape in shapes.items():
        if arrays[key].shape != shape:
            refuse(key, f"shape {arrays[key].shape}", f"shape {shape}")
    for key, value in arrays.items():
        if not np.isfinite(value).all():
            refuse(key, "not finite", "finite numbers")
    for key in ("u_max", "rate_max"):
        if not (arrays[key] > 0).all():
            refuse(key, f"{arrays[key].tolist()}", "positive limits")
    schedule = Scheduled(Ts_s, speeds, a, B, arrays["L"], arrays["u_max"])
    radius = max(schedule.injection_radius(v) for v in np.linspace(speeds[0], speeds[-1], 2 * n_g - 1))
    if radius >= 1.0:
        refuse(
            "L",
            f"spectral radius of A - L C is {radius:.6g}",
            "below 1 at every node and midway between nodes",
        )


def control_files(project: Project, controller: ControllerCoefficients) -> dict[str, str]:
    """Controller files of a vehicle folder: text by file name.

    If [can.demand] gives places on the vehicle's own bus, the loop works on that bus (own_loop.py). A vehicle
    without a message for its demand gets the controller alone, without ECU code. Raises InputError when the
    controller does not fit the vehicle.
    """
    where = f"controller for vehicle {project.name}"
    n_u = int(controller.words["sizes"][-1])
    if controller.sizes["NM"] != project.n_y + 1 or n_u != project.n_u:
        raise InputError(
            where,
            "B",
            f"{controller.sizes['NM']} measurements, {n_u} inputs",
            f"{project.n_y + 1} (reference and outputs) and {project.n_u}",
        )
    if round(controller.Ts_s * 1e6) != round(project.Ts_s * 1e6):
        raise InputError(where, "Ts_s", f"{controller.Ts_s:g}", f"{project.Ts_s:g} of the vehicle")
    ends = (project.model.speed_min_mps, project.model.speed_max_mps)
    if not np.allclose((controller.speeds[0], controller.speeds[-1]), ends, rtol=1e-9):
        raise InputError(
            where,
            "speeds",
            f"{controller.speeds[0]:g} to {controller.speeds[-1]:g} m/s",
            f"the model's range, {ends[0]:g} to {ends[1]:g} m/s",
        )
    files = {"lpvguard_control.c": coefficient_source(controller)}
    if sends_demand(project):
        files |= {"lpvguard_bus.c": bus_source(project), **codec_files()}
    if project.can is not None and project.can.demand:
        files |= loop_files(project)
    return files
