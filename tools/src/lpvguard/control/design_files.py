"""Write the files of step 8 besides controller.json: numbers of Table II, of Figs. 5 and 6, and of a case.

report/design_pictures.py draws these numbers.
"""

import numpy as np

from ..base import artefacts
from ..engine.synthesis.cases import TableRow, case_weights, differences
from ..engine.synthesis.interconnection import PlantWeights
from ..engine.synthesis.table import Cell
from .frozen import FrozenProblem, table_files
from .worst_run import WorstRuns

OUTPUTS = (("r", "rad/s"), ("delta", "rad"))
"""Names and units of the paper's outputs."""
FINE = np.geomspace(1e-3, 1e3, 200)
"""rad/s"""


def _magnitude(W) -> np.ndarray:
    return np.abs(W.response(FINE)[:, 0, 0])


def _weights_figure(
    common: PlantWeights, objectives: list[tuple[float, float, PlantWeights]], command
) -> dict:
    """Numbers of Fig. 5; each entry of ``objectives`` holds A_t, A_u and the weights for them."""
    rows: dict[str, np.ndarray] = {}
    for A_t, A_u, weights in objectives:
        rows[f"W_t, A_t = {A_t:.4g}"], rows[f"W_u, A_u = {A_u:.4g}"] = (
            _magnitude(weights.W_t),
            _magnitude(weights.W_u[0]),
        )
    rows["W_R"] = _magnitude(common.W_R)
    signals = [("W_C", common.W_C, "rad/s")]
    for kind, both in (("n", common.W_n), ("w", common.W_w)):
        signals += [(f"W_{kind}{name}", W, unit) for (name, unit), W in zip(OUTPUTS, both, strict=True)]
    return {
        "omega_rad_s": FINE,
        "signals": [[name, _magnitude(W), unit] for name, W, unit in signals],
        "objectives": [[n, values] for n, values in rows.items()],
        "command": command,
    }


def _figures_file(figures: dict) -> dict[str, str]:
    return {"figures.json": artefacts.to_json({"kind": "figures", "schema": 1, **figures})}


def design_files(problem: FrozenProblem, cells: list[Cell], runs: WorstRuns | None) -> dict[str, str]:
    """Write the files of a vehicle's design.

    Parameters
    ----------
    problem : FrozenProblem
    cells : list of Cell, cells of Table II
    runs : WorstRuns, or None without drives; Fig. 6 needs drives

    Returns
    -------
    dict[str, str], text by file name
    """
    common = problem.weights("K_i", *problem.settings.objectives[0])
    objectives = [(A_t, A_u, problem.weights("K_inf", A_t, A_u)) for A_t, A_u in problem.settings.objectives]
    W_C = problem.stored.fitted.W_C[0]
    figures = {"fig5": _weights_figure(common, objectives, [W_C.omega, W_C.bound])}
    if runs is not None:
        figures["fig6"] = runs.to_dict()
    frames = "deciding frames of the drives" if problem.frames.complete else "stored sample of frames"
    return table_files(
        [c.to_dict() for c in cells],
        vehicle=problem.stored.project.name,
        speed_mps=problem.settings.design_speed_mps,
        Ts_s=problem.stored.project.Ts_s,
        delay_samples=1,
        lambda_s=problem.settings.lambda_s,
        state_uncertainty_from=frames,
    ) | _figures_file(figures)


def case_files(name: str, case: dict, rows: list[TableRow]) -> dict[str, str]:
    """Write the files of a case's table; each row states its difference from the paper's row.

    Parameters
    ----------
    name : str
    case : dict, the case file
    rows : list[TableRow]

    Returns
    -------
    dict[str, str], text by file name
    """
    objectives = [(o["A_t"], o["A_u"], case_weights(case, o)) for o in case["objective"]]
    table = [
        row.to_dict() | {"difference": text} for row, text in zip(rows, differences(case, rows), strict=True)
    ]
    return table_files(table, case=name) | _figures_file(
        {"fig5": _weights_figure(objectives[0][2], objectives, None)}
    )
