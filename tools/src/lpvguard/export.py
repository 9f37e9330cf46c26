"""Stage 6, export: one generated folder per vehicle that the C core is compiled with.

    lpvguard_vehicle.h   name and sizes
    lpvguard_coeff.c     the coefficients (lib/include/lpvguard/coeff.h describes every field)
    lpvguard_signals.h   the signal table: order, units, signs, ranges
    SIGNALS.md           the same for people
    MANIFEST.json        where the numbers come from: hashes, settings, estimator, drives, errors of the speed tables

No clock time is written: the same input gives the same bytes. Numbers are printed with 9 (float) or 17 (double)
significant digits, so that reading returns the same number.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from . import __version__, artefacts
from .frames import Estimator
from .nominal import NominalModel
from .project import Project

if TYPE_CHECKING:
    from .identify import StoredIdentification

MAGIC, SCHEMA = 0x4C505647, 1
@dataclass(frozen=True)
class Coefficients:
    """Everything the core is compiled with: sizes, 32-bit words and numbers, in the order of coeff.h."""

    vehicle: str
    estimator_id: int
    sizes: dict[str, int]
    words: dict[str, np.ndarray]
    reals: dict[str, np.ndarray]
    table_error: float

    def flat_words(self) -> np.ndarray:
        return np.concatenate([np.atleast_1d(v).ravel() for v in self.words.values()]).astype(np.uint32)

    def flat_reals(self) -> np.ndarray:
        return np.concatenate([np.atleast_1d(v).ravel() for v in self.reals.values()]).astype(float)

    def crc32(self, real_bytes: int) -> int:
        """CRC-32 as lpvg_coeff_crc32 computes it, for 4- or 8-byte numbers."""
        words = dict(self.words, real_bytes=np.array(real_bytes), crc32=np.array(0))
        flat = np.concatenate([np.atleast_1d(v).ravel() for v in words.values()])
        payload = struct.pack(f"<{len(flat)}I", *(int(w) for w in flat))
        numbers = self.flat_reals().astype("<f4" if real_bytes == 4 else "<f8").tobytes()
        return zlib.crc32(payload + numbers)


def build_coefficients(project: Project, model: NominalModel, estimator: Estimator, W_delta: np.ndarray, B_w: np.ndarray,
                       threshold: float) -> Coefficients:
    """Coefficients from the model, the estimator and the fitted weights at the bins: W_delta (K,), B_w (K, n_y)."""
    table = model.table
    K = estimator.n_bins
    phase = 2 * np.pi * estimator.cycles / estimator.length
    taper = 2 * np.pi / estimator.length
    half_sum = estimator.length / 2  # sum of a periodic Hann window
    sizes = {"NX": model.n, "NU": model.n_u, "NY": model.n_y, "DELAY": model.delay, "NBINS": K,
             "NCELLS": len(table.cell), "NVARYING": len(table.varying)}
    words = {"magic": MAGIC, "schema": SCHEMA, "real_bytes": 4, "sizes": list(sizes.values()),
             "estimator_id": estimator.identifier(), "crc32": 0, "sample_period_us": round(project.Ts_s * 1e6),
             "settle_samples": estimator.settle, "confirm": project.frame_test.confirm,
             "of_last": project.frame_test.of_last, "frame_length": estimator.length, "cycles": estimator.cycles,
             "varying_entry": table.varying}
    # cos - 1 = -2 sin^2(half angle) keeps its relative precision for small angles.
    reals = {"speed_min": model.speed_range[0], "speed_max": model.speed_range[1],
             "speed_valid": [project.speed.min, project.speed.max],
             "input_valid": [[s.min, s.max] for s in project.inputs],
             "output_valid": [[s.min, s.max] for s in project.outputs],
             "speed_tolerance": estimator.speed_tolerance,
             "input_offset": model.input_offset, "output_offset": model.output_offset,
             "base": table.base, "cell": table.cell, "C": model.C, "C_pinv": np.linalg.pinv(model.C),
             "turn": np.stack([-2 * np.sin(phase / 2) ** 2, np.sin(phase)], axis=1),
             "taper": np.stack([-2 * np.sin(taper / 2) ** 2, np.sin(taper)], axis=1),
             "scale": np.where(estimator.cycles > 0, 2.0, 1.0) / half_sum,
             "W_delta": W_delta, "B_w": B_w, "threshold": threshold}
    return Coefficients(project.name, estimator.identifier(), sizes, {k: np.array(v) for k, v in words.items()},
                        {k: np.array(v, float) for k, v in reals.items()}, table.error)


def _braced(values: np.ndarray, show) -> str:
    if values.ndim == 0:
        return show(values.item())
    if values.ndim == 1 and values.size > 8:
        items = [show(v) for v in values.tolist()]
        rows = [", ".join(items[i:i + 8]) for i in range(0, len(items), 8)]
        return "{" + ",\n         ".join(rows) + "}"
    return "{" + ", ".join(_braced(v, show) for v in values) + "}"


def _literals(value: float) -> str:
    """C text for ``value`` rounded once to float and, separately, to double: a compiler that read one decimal text for
    both would round it differently from numpy where the double lies midway between two floats."""

    def text(digits: str) -> str:
        return digits if any(c in digits for c in ".en") else digits + ".0"

    return f"LPVG_NUMBER({text(f'{np.float32(value):.9g}')}f, {text(f'{value:.17g}')})"


def _coefficient_source(c: Coefficients) -> str:
    def word(value: int) -> str:
        return f"{int(value)}U"

    lines = ["/* Generated by lpvguard export; do not edit. Fields, units and sources: lpvguard/coeff.h. */",
             '#include "lpvguard/coeff.h"', "", "#ifdef LPVG_DOUBLE", f"#define COEFF_CRC32 {c.crc32(8)}U", "#else",
             f"#define COEFF_CRC32 {c.crc32(4)}U", "#endif", "", "const lpvg_coeff_t lpvg_coeff = {", "    .words = {"]
    special = {"real_bytes": "(uint32_t)sizeof(lpvg_real_t)", "crc32": "COEFF_CRC32"}
    for name, value in c.words.items():
        lines.append(f"        .{name} = {special.get(name) or _braced(value, word)},")
    lines += ["    },", "    .reals = {"]
    for name, value in c.reals.items():
        lines.append(f"        .{name} = {_braced(value, _literals)},")
    lines += ["    },", "};", ""]
    return "\n".join(lines)


def _vehicle_header(c: Coefficients) -> str:
    guard = f"LPVGUARD_VEHICLE_{c.vehicle.upper()}_H"
    sizes = "\n".join(f"#define LPVG_{name} {value}" for name, value in c.sizes.items())
    return (f"/* Generated by lpvguard export; do not edit. Name and sizes of this vehicle. */\n#ifndef {guard}\n"
            f"#define {guard}\n\n#define LPVG_VEHICLE {c.vehicle}\n{sizes}\n"
            f"#define LPVG_ESTIMATOR_ID {c.estimator_id}U\n\n#endif\n")


def _signals_header(project: Project) -> str:
    lines = ["/* Generated by lpvguard export; do not edit. The vehicle's signal table. */",
             f"#ifndef LPVGUARD_SIGNALS_{project.name.upper()}_H", f"#define LPVGUARD_SIGNALS_{project.name.upper()}_H", ""]
    for role, group in (("INPUT", project.inputs), ("OUTPUT", project.outputs)):
        lines += [f"#define LPVG_{role}_{s.name.upper()} {i} /* [{s.unit}] {s.min:g}..{s.max:g}, {s.positive} > 0 */"
                  for i, s in enumerate(group)]
    return "\n".join([*lines, "", "#endif", ""])


def signal_table_markdown(project: Project) -> str:
    """The signal table for people."""
    rows = [f"| {s.name} | {s.role} | {s.column} | {s.unit} | {s.positive} | {s.min:g} .. {s.max:g} | "
            + (f"{s.can.message}.{s.can.signal} = {s.can.factor:g} × value" if s.can else "–") + " |"
            for s in project.signals]
    return "\n".join([f"# Signals of `{project.name}`", "", project.title, "",
                      "| signal | role | column | unit | positive | range | CAN |", "| --- | --- | --- | --- | --- | --- | --- |",
                      *rows, ""])


def vehicle_files(project: Project, coefficients: Coefficients, provenance: dict) -> dict[str, str]:
    """File name -> text of the generated folder; ``provenance`` goes into the manifest as it is."""
    files = {"lpvguard_vehicle.h": _vehicle_header(coefficients), "lpvguard_coeff.c": _coefficient_source(coefficients),
             "lpvguard_signals.h": _signals_header(project), "SIGNALS.md": signal_table_markdown(project)}
    manifest = {"schema": SCHEMA, "tool": f"lpvguard {__version__}", "vehicle": project.name, "sizes": coefficients.sizes,
                "estimator_id": coefficients.estimator_id, "speed_table_relative_error": coefficients.table_error,
                "crc32": {"float": coefficients.crc32(4), "double": coefficients.crc32(8)}, **provenance}
    files[artefacts.MANIFEST] = artefacts.to_json(manifest)
    return files


def write_files(folder: Path, files: dict[str, str | bytes]) -> None:
    """Write text files into an existing folder."""
    for name, content in files.items():
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)


def export_vehicle(stored: StoredIdentification, target: Path) -> None:
    """Write the generated folder of an identification, whole or not at all."""
    provenance = {"kind": "vehicle", "identification": stored.manifest, "threshold": stored.calibration.to_dict(),
                  "final_inflation": stored.weights["inflation"],
                  "weights": {k: stored.weights[k] for k in ("W_w", "W_delta")},
                  "project": stored.project.model_dump(by_alias=True)}
    with artefacts.new_folder(target) as folder:
        write_files(folder, vehicle_files(stored.project, stored.coefficients, provenance))
