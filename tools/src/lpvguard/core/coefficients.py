"""Stage 6, export: make one generated folder per vehicle, which the C core is compiled with.

    lpvguard_vehicle.h   name and sizes
    lpvguard_coeff.c     the coefficients (lib/include/lpvguard/coeff.h describes every field)
    lpvguard_diagnosis.c the table of the diagnosis (diagnosis.h), where the identification has one
    lpvguard_isolation.c, lpvguard_parts.h   with [isolation] only: its table, names of the parts
    lpvguard_control.c, lpvguard_bus.c, lpvg_can_codec.h/.c   with a controller only: control_coefficients.py
    lpvguard_signals.h   the signal table: order, units, signs, ranges
    SIGNALS.md           the signal table as a readable page
    MANIFEST.json        origin of the numbers: hashes, settings, estimator, drives, errors of the speed
                         tables; and the seal of all these files (base/artefacts.py)

No clock time is written: the same input gives the same bytes. Numbers have 9 (float) or 17 (double)
significant digits, so that reading returns the same number.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .. import __version__
from ..base import artefacts
from ..base.layout import COEFF, DIMENSIONS, constant
from ..drives.frames import Estimator, require_core
from ..vehicle.nominal import NominalModel
from ..vehicle.project import CanPlace, Project
from .control_coefficients import CONTROL_SIZES, ControllerCoefficients, control_files
from .seal import Sealed, coefficient_source

MANIFEST_SCHEMA = 1


@dataclass(frozen=True)
class Coefficients(Sealed):
    """Model, estimator and monitor of a vehicle (coeff.h).

    Attributes
    ----------
    vehicle : str, its name
    estimator_id : int, identifies the estimator of the bounds
    table_error : float
    """

    LAYOUT = COEFF
    vehicle: str
    estimator_id: int
    table_error: float


class TestPart(Protocol):
    """Part of the coefficients that belongs to one test (identify/energy.py, identify/change.py)."""

    def coefficients(self) -> tuple[dict[str, int], Mapping[str, ArrayLike], dict[str, np.ndarray]]:
        """Sizes by dimension, and words and numbers by field of coeff.h in the field's shape."""


def build_coefficients(
    project: Project,
    model: NominalModel,
    estimator: Estimator,
    W_delta: np.ndarray,
    B_w: np.ndarray,
    threshold: float,
    energy: TestPart,
    change: TestPart,
    pools: TestPart | None = None,
    certificate: tuple[np.ndarray, np.ndarray] | None = None,
) -> Coefficients:
    """Build a vehicle's coefficients from the model, the estimator, the weights and the tests.

    Parameters
    ----------
    project : Project
    model : NominalModel
    estimator : Estimator
    W_delta : ndarray (K, n_delta), uncertainty weight of the frame test at the bins
    B_w : ndarray (K, n_y), disturbance weight of the frame test at the bins, units of the outputs
    threshold : float, threshold of the frame test
    energy, change : TestPart, parts of the energy and the change test
    pools : TestPart, optional, bounds of pools of frames; by default there are no pools
    certificate : tuple of both weights, optional, weights of the certificate; by default the frame test's

    Returns
    -------
    Coefficients

    Raises
    ------
    InputError
        If the bounds come from the plain DFT, or a part does not fit the project's structure.
    """
    require_core(project)
    table = model.table
    (sizes_e, words_e, reals_e), (sizes_c, words_c, reals_c) = (t.coefficients() for t in (energy, change))
    W_certificate, B_certificate = (W_delta, B_w) if certificate is None else certificate
    words_p, reals_p = _without_pools(estimator, project) if pools is None else pools.coefficients()[1:]
    sizes = {
        "NX": model.n,
        "NU": model.n_u,
        "NY": model.n_y,
        "DELAY": model.delay,
        "NBINS": estimator.n_bins,
        "NCELLS": len(table.cell),
        "NVARYING": len(table.varying),
        "NDELTA": project.n_delta,
        **sizes_e,
        **sizes_c,
    }
    words = {
        **COEFF.head(sizes),
        "estimator_id": estimator.identifier(),
        "sample_period_us": round(project.Ts_s * 1e6),
        "settle_samples": estimator.settle,
        "confirm": project.frame_test.confirm,
        "of_last": project.frame_test.of_last,
        **words_e,
        **words_c,
        "frame_length": estimator.length,
        "cycles": estimator.cycles,
        **words_p,
        "varying_entry": table.varying,
    }
    reals: dict[str, ArrayLike] = {
        **_model_reals(project, model),
        **_estimator_reals(estimator),
        **reals_e,
        **reals_c,
        "W_delta": W_delta,
        "B_w": B_w,
        "W_certificate": W_certificate,
        "B_certificate": B_certificate,
        **reals_p,
        "threshold": threshold,
    }
    numbers = {name: np.array(value, float) for name, value in reals.items()}
    return Coefficients(sizes, words, numbers, project.name, estimator.identifier(), table.error)


def _without_pools(
    estimator: Estimator, project: Project
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Words and numbers for a vehicle without pools of frames."""
    one = np.ones(estimator.n_bins, int)
    none = np.zeros((constant("NSPEEDS", {}), estimator.n_bins, 2, project.n_y))
    return {"pool_parts": one, "pool_frames": one}, {"pool_scale": none}


def _model_reals(project: Project, model: NominalModel) -> dict[str, ArrayLike]:
    """Ranges of the signals, and the table of the model over speed."""
    return {
        "speed_min": model.speed_range[0],
        "speed_max": model.speed_range[1],
        "speed_valid": [project.speed.min, project.speed.max],
        "input_valid": [[s.min, s.max] for s in project.inputs],
        "output_valid": [[s.min, s.max] for s in project.outputs],
        "input_offset": model.input_offset,
        "output_offset": model.output_offset,
        "base": model.table.base,
        "cell": model.table.cell,
        "C": model.C,
        "C_pinv": model.least_state_of_output,
    }


def _estimator_reals(estimator: Estimator) -> dict[str, ArrayLike]:
    """Rotation of bin and Hann window per sample, minus one, and the scale of a frame's sum."""
    phase = 2 * np.pi * estimator.cycles / estimator.length
    taper = 2 * np.pi / estimator.length
    half_sum = estimator.length / 2  # sum of a periodic Hann window
    # cos - 1 = -2 sin^2(half angle) keeps its relative precision for small angles.
    return {
        "speed_tolerance": estimator.speed_tolerance,
        "turn": np.stack([-2 * np.sin(phase / 2) ** 2, np.sin(phase)], axis=1),
        "taper": np.stack([-2 * np.sin(taper / 2) ** 2, np.sin(taper)], axis=1),
        "scale": np.where(estimator.cycles > 0, 2.0, 1.0) / half_sum,
    }


def _vehicle_header(c: Coefficients, controller: ControllerCoefficients | None) -> str:
    guard = f"LPVGUARD_VEHICLE_{c.vehicle.upper()}_H"
    values = c.sizes | (controller.sizes if controller else dict.fromkeys(CONTROL_SIZES, 0))
    sizes = "\n".join(f"#define LPVG_{name} {values[name]}" for name in DIMENSIONS)
    return (
        f"/* Generated by lpvguard export; do not edit. Name and sizes of this vehicle. */\n#ifndef {guard}\n"
        f"#define {guard}\n\n#define LPVG_VEHICLE {c.vehicle}\n{sizes}\n"
        f"#define LPVG_ESTIMATOR_ID {c.estimator_id}U\n\n#endif\n"
    )


def _signals_header(project: Project) -> str:
    lines = [
        "/* Generated by lpvguard export; do not edit. The vehicle's signal table. */",
        f"#ifndef LPVGUARD_SIGNALS_{project.name.upper()}_H",
        f"#define LPVGUARD_SIGNALS_{project.name.upper()}_H",
        "",
    ]
    for role, group in (("INPUT", project.inputs), ("OUTPUT", project.outputs), ("GATE", project.gates)):
        lines += [
            f"#define LPVG_{role}_{s.name.upper()} {i} "
            f"/* [{s.unit}] {s.min:g}..{s.max:g}, {s.positive} > 0 */"
            for i, s in enumerate(group)
        ]
    return "\n".join([*lines, "", "#endif", ""])


def _bus_value(place: CanPlace) -> str:
    return " + ".join(f"{place.message}.{name}" for name in (place.signal, *place.plus))


def signal_table_markdown(project: Project) -> str:
    """The signal table as a Markdown page."""
    rows = [
        f"| {s.name} | {s.role} | {s.column} | {s.unit} | {s.positive} | {s.min:g} .. {s.max:g} | "
        + (f"{_bus_value(s.can)} = {s.can.factor:g} × value" if s.can else "–")
        + " |"
        for s in project.signals
    ]
    return "\n".join(
        [
            f"# Signals of `{project.name}`",
            "",
            project.title,
            "",
            "| signal | role | column | unit | positive | range | CAN |",
            "| --- | --- | --- | --- | --- | --- | --- |",
            *rows,
            "",
        ]
    )


def vehicle_files(
    project: Project,
    coefficients: Coefficients,
    provenance: dict,
    controller: ControllerCoefficients | None = None,
    diagnosis: Sealed | None = None,
    isolation: tuple[Sealed, str] | None = None,
) -> dict[str, str]:
    """Return the files of a vehicle's generated folder.

    Parameters
    ----------
    project : Project
    coefficients : Coefficients
    provenance : dict, goes into the manifest unchanged
    controller : ControllerCoefficients or None, optional
    diagnosis : Sealed, optional, table of diagnosis.h
    isolation : tuple of Sealed and str, optional, table of isolation.h and text of lpvguard_parts.h

    Returns
    -------
    dict[str, str], text by file name
    """
    files = {
        "lpvguard_vehicle.h": _vehicle_header(coefficients, controller),
        "lpvguard_coeff.c": coefficient_source(coefficients),
        "lpvguard_signals.h": _signals_header(project),
        "SIGNALS.md": signal_table_markdown(project),
    }
    manifest = {
        "schema": MANIFEST_SCHEMA,
        "tool": f"lpvguard {__version__}",
        "vehicle": project.name,
        "sizes": coefficients.sizes,
        "estimator_id": coefficients.estimator_id,
        "speed_table_relative_error": coefficients.table_error,
        "crc32": coefficients.crc32_by_type(),
    }
    if diagnosis is not None:
        files["lpvguard_diagnosis.c"] = coefficient_source(diagnosis)
        manifest["diagnosis"] = {"crc32": diagnosis.crc32_by_type()}
    if isolation is not None:
        table, files["lpvguard_parts.h"] = isolation
        files["lpvguard_isolation.c"] = coefficient_source(table)
        manifest["isolation"] = {"crc32": table.crc32_by_type()}
    if controller is not None:
        files |= control_files(project, controller)
        manifest["controller"] = controller.manifest()
    files[artefacts.MANIFEST] = artefacts.to_json({**manifest, **provenance})
    return files
