"""Control problem of Fig. 1 at a frozen speed, for any structure, objective and weights; Table II."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..base.progress import Counted, Progress
from ..engine.synthesis.interconnection import STRUCTURES, GeneralisedPlant, PlantWeights
from ..engine.synthesis.statespace import StateSpace
from ..engine.synthesis.table import Cell, cell, to_csv
from ..identify.identification import StoredIdentification
from ..identify.weights import FittedWeight
from .plants import DesignProblem, plant_at, weight_system
from .stored_frames import SplitWeights, StoredFrames


def compared(stored: StoredIdentification) -> bool:
    """Tell whether the design compares structures for a vehicle: only for vehicles of the paper's class.

    That class has one Delta, one input and two outputs. The two outputs are the first two states.

    Parameters
    ----------
    stored : StoredIdentification

    Returns
    -------
    bool
    """
    project, first_two = stored.project, np.eye(2, stored.model.n)
    sizes = (project.n_delta, project.n_u, project.n_y)
    return sizes == (1, 1, 2) and bool((first_two == stored.model.C).all())


class FrozenProblem:
    """Control problem of an identification at frozen speeds, for structures with one Delta.

    Parameters
    ----------
    stored : StoredIdentification
    frames : StoredFrames

    Raises
    ------
    InputError
        If there is no [design] table, or if the vehicle is not of the paper's class S1 (`compared`).
    """

    def __init__(self, stored: StoredIdentification, frames: StoredFrames):
        if len(stored.fitted.W_delta) > 1:
            raise InputError(
                stored.folder,
                "bounds.structure",
                f"{stored.project.bounds.structure}: {len(stored.fitted.W_delta)} Deltas, one per output",
                "S0 or S1, because Table II and the trade-off need one Delta",
            )
        if not compared(stored):
            raise InputError(
                stored.folder,
                "signals",
                f"{stored.project.n_u} input(s) and {stored.project.n_y} output(s)",
                "one input and two outputs, because Table II and the trade-off need them",
            )
        self.problem = DesignProblem.from_identification(stored)
        self.stored, self.frames, self.settings = stored, frames, self.problem.settings

    @cached_property
    def with_state(self) -> SplitWeights:
        """Weights of class S2, for the identified gamma_w and the settings' Lambda_nu = diag(1, lambda_s)."""
        split = self.frames.explain_with_state(self.stored.bounds["gamma_w"], self.settings.lambda_s)
        return self.frames.weights(split)

    def weights(
        self, structure: str, A_t: float, A_u: float, fitted: SplitWeights | None = None
    ) -> PlantWeights:
        """Weights of Fig. 1. ``fitted`` replaces the identified W_w and W_delta (K_is: `with_state`)."""
        chosen = self.settings.model_copy(update={"structure": structure, "A_t": A_t, "A_u": A_u})
        # K_is has its own weights, which replace those of class S1 below.
        if structure == "K_is":
            chosen = chosen.model_copy(update={"structure": "K_i"})
        weights = self.problem.with_settings(chosen).weights
        if structure == "K_is" and fitted is None:
            fitted = self.with_state
        if structure == "K_inf" or fitted is None:
            return weights

        def inflated(weight: FittedWeight) -> StateSpace:
            return weight_system(weight, self.stored.fitted.inflation)

        return replace(
            weights,
            W_w=tuple(map(inflated, fitted.W_w)),
            W_delta_i=inflated(fitted.W_delta_i),
            W_delta_s=inflated(fitted.W_delta_s or fitted.W_delta_i),
        )

    def plant(self, structure: str, weights: PlantWeights, v: float) -> GeneralisedPlant:
        """Discrete plant at speed v [m/s] with one sample of delay before the control input."""
        return plant_at(self.problem.model, weights, v, True, structure)

    def table(self, progress: Progress = lambda _: None) -> list[Cell]:
        """Compute Table II at the design speed: the three structures for each objective."""
        cells: list[Cell] = []
        most = len(self.settings.objectives) * len(STRUCTURES)
        for A_t, A_u in self.settings.objectives:
            for structure in STRUCTURES:
                progress(Counted(f"Table II: {structure}, A_t {A_t:g}, A_u {A_u:g}", len(cells), most))
                plant = self.plant(
                    structure, self.weights(structure, A_t, A_u), self.settings.design_speed_mps
                )
                cells.append(cell(plant, structure, A_t, A_u))
        return cells


def table_files(rows: list[dict], **about) -> dict[str, str]:
    """Make table2.json and table2.csv from the table's rows; ``about`` holds further JSON fields."""
    return {
        "table2.json": artefacts.to_json({"kind": "table2", "schema": 1, **about, "rows": rows}),
        "table2.csv": to_csv(rows),
    }
