"""The core at the ends of its sizes, float and double: monitor and controller against double arithmetic from
the definitions.

n_x 1..40, n_u 1..2, n_y 1..4, 2..64 bins and 1..40 controller states of all demands are compile-time
constants (lib/include/lpvguard/config.h). The corners run always, the whole grid with LPVGUARD_FULL=1.
"""

import os
import subprocess
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from lpvguard.base import native
from lpvguard.base.artefacts import write_files
from lpvguard.core.coefficients import build_coefficients, vehicle_files
from lpvguard.core.compiled import Core, library_root, shipped_vehicle
from lpvguard.core.control_coefficients import replaced_controller
from lpvguard.drives.frames import Estimator
from lpvguard.engine.overbound.weight import Weight
from lpvguard.engine.validation import s1
from lpvguard.identify.change import ChangeTest
from lpvguard.identify.energy import EnergyTest
from lpvguard.vehicle.nominal import NominalModel
from synthetic_vehicle import SPEEDS, TS, Sizes, synthetic_controller, synthetic_project

CORNERS = [
    (Sizes(1, 1, 1, 2), False),
    (Sizes(40, 2, 4, 64, 3, 20), False),
    (Sizes(40, 2, 4, 64, 3, 20), True),
    (Sizes(7, 1, 3, 17, 1, 40), False),
    (Sizes(7, 1, 3, 17, 1, 40, "S1_diagonal"), False),
]
GRID = [
    (Sizes(n_x, n_u, n_y, bins, delay, n_k, structure), double)
    for (n_x, delay, n_k), n_u, n_y, bins, structure, double in product(
        [(1, 0, 1), (2, 1, 20), (40, 3, 13)],
        (1, 2),
        (1, 2, 3, 4),
        (2, 64),
        ("S1", "S1_diagonal"),
        (False, True),
    )
]
CASES = list(dict.fromkeys(CORNERS + (GRID if os.environ.get("LPVGUARD_FULL") == "1" else [])))
TABLE = 2e-5
"""What the tabulated model may differ from the exact one, of an output's size (tests/unit/test_model.cpp)."""


def label(case):
    return f"{'double' if case[1] else 'float'}-" + "-".join(f"{k}{v}" for k, v in vars(case[0]).items())


@pytest.fixture(scope="module", params=CASES, ids=label)
def case(request, tmp_path_factory):
    """Sizes, number type, model, estimator, bounds (W_delta, B_w), and the vehicle's folder."""
    sizes, double = request.param
    project = synthetic_project(sizes)
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    assert estimator.n_bins == sizes.bins and model.delay == sizes.delay
    each = 1.0 + 0.2 * np.arange(project.n_delta)
    W_delta = np.outer(np.linspace(0.1, 0.3, sizes.bins), each)
    B_w = np.outer(np.linspace(0.02, 0.01, sizes.bins), 1.0 + np.arange(sizes.n_y))
    folder = tmp_path_factory.mktemp("synthetic") / "synthetic"
    folder.mkdir()
    energy = EnergyTest.design(
        project,
        estimator,
        [Weight(factor * np.array([0.3, 0.2, 0.1]), [1.0, 1.0, 0.5]) for factor in each],
        estimator.omega[1:],
        np.full((sizes.bins - 1, project.n_delta), 0.1),
        1.0,
    )
    sigma = 0.02 * np.add.outer(np.arange(len(energy.F)), 1.0 + np.arange(sizes.n_y))
    energy = replace(energy, sigma=sigma, start=np.sqrt(4.0 + np.arange(sizes.n_y)) * sigma)
    write_files(
        folder,
        vehicle_files(
            project,
            build_coefficients(
                project, model, estimator, W_delta, B_w, 1.5, energy, ChangeTest.design(project)
            ),
            {"kind": "test"},
        ),
    )
    return sizes, double, model, estimator, W_delta, B_w, folder


def exact_outputs(model, v, u, y_first):
    """Nominal output by the exact zero-order hold at every speed: no table, nothing shared with the core."""
    speeds, which = np.unique(v, return_inverse=True)
    d = model.discretise(speeds)
    du = u - model.input_offset
    x = np.linalg.pinv(model.C) @ (y_first - model.output_offset)
    outputs = np.empty((len(v), model.n_y))
    for k, s in enumerate(which):
        outputs[k] = model.C @ x + model.output_offset
        x = (
            d.Ad[s] @ x
            + d.B_old[s] @ du[max(k - model.delay - 1, 0)]
            + d.B_new[s] @ du[max(k - model.delay, 0)]
        )
    return outputs


@pytest.mark.requirement("REQ-CORE-5")
@pytest.mark.slow("6 s a core: one is compiled for every size")
def test_frames_and_margins_equal_the_reference_at_every_size(case):
    sizes, double, model, estimator, W_delta, B_w, folder = case
    rng = np.random.default_rng(4)
    n = int(estimator.settle + 3 * estimator.length[0])
    k = np.arange(n)
    v = 15.0 + 3.0 * np.round(4 * np.sin(0.002 * k)) / 4
    f = rng.uniform(0.1, 3.0, (sizes.n_u, 12))
    u = np.stack(
        [np.sin(2 * np.pi * TS * np.outer(k, row) + rng.uniform(0, 6, 12)).sum(axis=1) / 3 for row in f],
        axis=1,
    )
    yhat = exact_outputs(model, v, u, model.output_offset)
    size = np.abs(yhat - model.output_offset).max(axis=0)
    y = 0.7 * yhat + 0.05 * size * rng.standard_normal(yhat.shape)
    run = Core(folder, double=double).monitor().run(TS * k, v, u, y)
    assert (run.status == 0).all()
    frames, e = run.frames, y - yhat
    counted = np.flatnonzero(frames.counted)
    assert set(frames.bin[counted]) == set(range(sizes.bins))
    # float: rounding of the sums and of the recursion; both: the table of the model over speed.
    allowed = (TABLE if double else 2 * TABLE) * size
    worst = 0.0
    for b in range(sizes.bins):
        rows = counted[frames.bin[counted] == b]
        N = int(estimator.length[b])
        starts = np.round(frames.t_end_s[rows] / TS).astype(int) + 1 - N
        kernel = estimator.kernel(b)
        E, Z = (np.array([kernel @ x[s : s + N] for s in starts]) for x in (e, yhat))
        assert (np.abs(frames.E[rows] - E) <= allowed).all() and (np.abs(frames.Z[rows] - Z) <= allowed).all()
        # Of the frames as the core has them: what is compared is the margin, not its sensitivity to the
        # frame.
        t = s1.margin(frames.E[rows], frames.Z[rows], W_delta[b], B_w[b])
        scale = np.abs(frames.E[rows] / B_w[b]).max(axis=1)
        worst = max(worst, float((np.abs(frames.margin[rows] - t) / scale).max()))
    assert worst <= (1e-9 if double else 1.1e-6)  # float: margin.hpp


def dense(controller, v, m):
    """Demand (N, n_u) of the law of controller.h in double, with full matrices; L = 0, engaged while m is
    zero."""
    c = controller.reals
    nodes, n_u, n_k, _ = c["BL"].shape
    A1 = np.zeros((n_k, n_k))
    heads = [i - i % 2 for i in range(n_k)]
    for i, head in enumerate(heads):
        A1[i, head] += c["A1"][i]  # of h for h and t alike
        if i == head and i + 1 < n_k:
            A1[i, i + 1] = 1.0
    C = np.array([float(i == head) for i, head in enumerate(heads)])
    x, u, out = np.zeros((n_u, n_k)), np.zeros(n_u), []
    for speed, measured in zip(v, m, strict=False):
        position = (np.clip(speed, *SPEEDS) - SPEEDS[0]) / (SPEEDS[1] - SPEEDS[0]) * (nodes - 1)
        node = min(int(position), nodes - 2)
        B = ((1 - position + node) * c["BL"][node] + (position - node) * c["BL"][node + 1])[
            :, :, : len(measured)
        ]
        top = (1 - position + node) * c["u_max"][node] + (position - node) * c["u_max"][node + 1]
        u = np.clip(np.clip(x @ C, -top, top), u - c["rate_max"] * TS, u + c["rate_max"] * TS)
        out.append(u)
        x = x + x @ A1.T + B @ measured
    return np.array(out)


@pytest.mark.requirement("REQ-CORE-5")
@pytest.mark.slow("6 s a core: one is compiled for every size")
def test_the_controller_equals_the_reference_at_every_size(case, tmp_path):
    sizes, double, *_, folder = case
    controller = synthetic_controller(sizes)
    files = {p.name: p.read_text() for p in folder.glob("lpvguard_*.h")}
    write_files(tmp_path, files | replaced_controller(files["lpvguard_vehicle.h"], controller))
    program = native.compile_executable(
        [
            library_root() / "src" / "guard" / "controller.cpp",
            tmp_path / "lpvguard_control.c",
            Path(__file__).with_name("controller_run.cpp"),
        ],
        name="controller_run",
        flags=("-std=c++17", "-O2", "-ffp-contract=off", *(["-DLPVG_DOUBLE"] if double else [])),
        include_dirs=[library_root() / "include", library_root() / "src", tmp_path],
    )
    k = np.arange(4000)
    v = (15.0 + 8.0 * np.sin(0.003 * k)).astype(np.float32)
    m = np.sin(np.outer(0.01 * k, 1 + np.arange(1 + sizes.n_y))).astype(np.float32)
    done = subprocess.run(
        [program], input=np.column_stack([v, m]).astype(float).tobytes(), stdout=subprocess.PIPE, check=True
    )
    u = np.frombuffer(done.stdout).reshape(len(k), sizes.n_u)
    want = dense(controller, v.astype(float), m.astype(float))
    assert np.abs(want).max() > 0.01
    assert np.abs(u - want).max() <= (1e-12 if double else 1e-5) * 6.0  # of the demand's range


@pytest.mark.requirement("REQ-CORE-5")
@pytest.mark.parametrize(
    "name, value, message",
    [
        ("LPVG_NX", 41, "1..40 states"),
        ("LPVG_NU", 3, "1..2 inputs"),
        ("LPVG_NY", 5, "1..4 outputs"),
        ("LPVG_NBINS", 65, "2..64 bins"),
        ("LPVG_NDELTA", 2, "one Delta common to all outputs, or one an output"),
        ("LPVG_NK", 41, "up to 40 states"),
    ],
)
def test_sizes_beyond_are_refused_by_the_compiler_with_their_name(name, value, message, tmp_path):
    folder = shipped_vehicle("g80")
    header = (folder / "lpvguard_vehicle.h").read_text().splitlines(keepends=True)
    (tmp_path / "lpvguard_vehicle.h").write_text(
        "".join(
            f"#define {name} {value}\n" if line.startswith(f"#define {name} ") else line for line in header
        )
    )
    # A copy: the compiler looks for headers beside the source first.
    source = tmp_path / "lpvguard_coeff.c"
    source.write_text((folder / source.name).read_text())
    include = ["-I", library_root() / "include", "-I", tmp_path]
    command = [*native.find_compiler(cxx=False), "-std=c99", "-fsyntax-only", *include, source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and message in done.stderr
