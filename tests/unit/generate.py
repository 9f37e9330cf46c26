"""Inputs of the C++ unit tests, made by the Python package.

    generate.py vehicle PROJECT DIR   a vehicle folder as `lpvguard export` writes it, with made-up weights
                                      and threshold
    generate.py separate PROJECT DIR  the same with a Delta for every output, called like DIR
    generate.py guarded PROJECT DIR   the same as vehicle with the hand-made controller, called like DIR;
                                      without the bus's glue where the project gives its signals no place on
                                      the bus
    generate.py three   PROJECT DIR   the same as guarded with a third output, and an even number of states of
                                      each demand; PROJECT is a file
    generate.py golden  PROJECT DIR   golden_model.hpp: a drive, and the nominal output by exact zero-order
                        hold in double
    generate.py life    PROJECT DIR   golden_life.hpp: tables of two calibration sets, scores, and the wealth
                        after each by the Python package

PROJECT is a shipped vehicle's name or a project file. One call may make several: KIND PROJECT DIR again and
again.
"""

import sys
import tomllib
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from lpvguard.base.artefacts import write_files
from lpvguard.core.coefficients import build_coefficients, vehicle_files
from lpvguard.core.control_coefficients import ARRAYS, build_controller, control_files, replaced_controller
from lpvguard.drives.frames import Estimator
from lpvguard.engine.overbound.weight import Weight
from lpvguard.extras.fleet.export import definition
from lpvguard.extras.fleet.wealth import Life, LifeTable
from lpvguard.identify.change import ChangeTest
from lpvguard.identify.energy import EnergyTest
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project, parse_project

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from hand_controller import hand_controller


def vehicle(project, model, size=1.0):
    """Files of a generated folder with bounds by hand; ``size``: factor on what the disturbance may be."""
    estimator = Estimator.from_project(project, model)
    each = 1.0 + 0.5 * np.arange(project.n_delta)
    W_delta = np.outer(np.linspace(0.1, 0.4, estimator.n_bins), each)
    B_w = size * np.outer(np.linspace(0.02, 0.01, estimator.n_bins), 1.0 + np.arange(project.n_y))
    energy = EnergyTest.design(
        project,
        estimator,
        [Weight(factor * np.array([0.3, 0.2, 0.1]), [1.0, 1.0, 0.5]) for factor in each],
        estimator.omega[1:],
        np.full((estimator.n_bins - 1, project.n_delta), 0.1),
        1.0,
    )
    sigma = size * 0.02 * np.add.outer(np.arange(len(energy.F)), 1.0 + np.arange(project.n_y))
    energy = replace(energy, sigma=sigma, start=np.sqrt(4.0 + np.arange(project.n_y)) * sigma)
    quiet = ChangeTest.design(project)
    quiet = replace(quiet, largest=1e3 * quiet.largest)  # a test that wants to hear it says so
    coefficients = build_coefficients(project, model, estimator, W_delta, B_w, 1.5, energy, quiet)
    return vehicle_files(project, coefficients, {"kind": "test"})


def separate(project, model, name):
    bounds = project.bounds.model_copy(update={"structure": "S1_diagonal"})
    return vehicle(project.model_copy(update={"name": name, "bounds": bounds}), model)


def guarded(project, model, name, single=True):
    project = project.model_copy(update={"name": name})
    document = hand_controller(project, single=single)
    controller = build_controller(document["Ts_s"], *(document[key] for key in ARRAYS))
    files = vehicle(project, model)
    glue = control_files(project, controller) if all(s.can for s in project.signals) else {}
    return {**files, **glue, **replaced_controller(files["lpvguard_vehicle.h"], controller)}


def with_third_output(path):
    """The project of a file with two outputs and two states, and a third output that is a mixture of them."""
    document = tomllib.loads(path.read_text())
    last = document["signals"][-1]
    document["signals"].append({**last, "name": "third_output", "column": "y3"})
    document["model"]["output_offset"].append(0.02)
    document["model"]["C"].append([0.6, -0.4])
    return parse_project(document, path.name)


def exact_outputs(model, v, u, y_first):
    """The recursion with the exact matrices at every speed: no speed table, no shared code with the core or
    `simulate`."""
    du = u - model.input_offset
    x = np.linalg.pinv(model.C) @ (y_first - model.output_offset)
    outputs = []
    for k in range(len(v)):
        outputs.append(model.C @ x + model.output_offset)
        d = model.discretise(v[k : k + 1])
        x = (
            d.Ad[0] @ x
            + d.B_old[0] @ du[max(k - model.delay - 1, 0)]
            + d.B_new[0] @ du[max(k - model.delay, 0)]
        )
    return np.array(outputs)


def golden(project, model):
    k = np.arange(400)
    low, high = model.speed_range
    v = 0.5 * (low + high) + 0.55 * (high - low) * np.sin(0.011 * k)  # leaves the range at both ends
    v[100:150] = v[100]
    u = np.array(
        [
            0.25 * s.max * np.sin((0.03 + 0.02 * i) * k + i) + 0.1 * s.max * (k % 37 == 0)
            for i, s in enumerate(project.inputs)
        ]
    ).T
    y_first = np.array([0.05 * (j + 1) * s.max for j, s in enumerate(project.outputs)])
    yhat = exact_outputs(model, v, u, y_first)

    def table(name, values):
        rows = ",\n    ".join("{" + ", ".join(f"{x:.17g}" for x in row) + "}" for row in values)
        return f"constexpr double {name}[{values.shape[0]}][{values.shape[1]}] = {{\n    {rows}}};\n"

    text = (
        "// Generated by tests/unit/generate.py.\n#pragma once\nnamespace golden {\n"
        + table("speed", v[:, None])
        + table("input", u)
        + table("first_output", y_first[None])
        + table("output", yhat)
        + "}  // namespace golden\n"
    )
    return {"golden_model.hpp": text}


def life(project, model):
    """Tables, and per score of a life the bits of the wealth and of each bet."""
    random = np.random.default_rng(project.seed)
    text = '// Generated by tests/unit/generate.py.\n#pragma once\n#include "lpvguard/life.h"\n'
    text += "struct GoldenStep { float score; uint32_t wealth, bet[LPVG_LIFE_BETS], changed_at; };\n"
    for n, drift in ((11, 1.5), (100, 0.8), (400, 0.0)):
        table = LifeTable.from_scores(random.random(n), 0.05, 0.05)
        scores = (random.random(400) + np.linspace(0.0, drift, 400)).astype(np.float32)
        scores[::50] = table.levels[-1]  # a tie is not above
        now, rows = Life(), []
        for score in scores:
            now = now.after(int(table.place(score)), table)
            bits = [int(np.float32(x).view(np.uint32)) for x in (now.wealth, *now.bets)]
            rows.append(
                f"{{{score:.9g}f, {bits[0]}U, {{{', '.join(f'{b}U' for b in bits[1:])}}}, {now.changed_at}U}}"
            )
        text += definition(table, 60.0, f"golden_table_{n}")
        text += f"constexpr GoldenStep golden_life_{n}[] = {{\n" + ",\n".join(rows) + "};\n"
    return {"golden_life.hpp": text}


def make(kind, project_name, folder):
    target = Path(folder)
    makers = {
        "vehicle": vehicle,
        "separate": partial(separate, name=target.name),
        "guarded": partial(guarded, name=target.name),
        "three": partial(guarded, name=target.name, single=False),
        "golden": golden,
        "life": life,
    }
    project = with_third_output(Path(project_name)) if kind == "three" else load_project(project_name)
    files = makers[kind](project, NominalModel(project))
    target.mkdir(parents=True, exist_ok=True)
    # Unchanged files keep their time, so that configuring again rebuilds nothing.
    write_files(
        target,
        {
            name: text
            for name, text in files.items()
            if not (target / name).is_file() or (target / name).read_text() != text
        },
    )


def main():
    words = sys.argv[1:]
    if not words or len(words) % 3:
        sys.exit(__doc__)
    for i in range(0, len(words), 3):
        make(*words[i : i + 3])


if __name__ == "__main__":
    main()
