"""`lpvguard fit`: parameters, delay and offsets of the nominal model from drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .shared import JsonOut, Out, Vehicle, app, console, emit, progress_bar, project_of
from .tables import print_fit

if TYPE_CHECKING:
    from ..fit.fitted_model import FittedModel

PICTURED, PICTURED_S = 3, 20.0
"""Number of drawn drives, and seconds of each."""


@app.command(epilog="Example: lpvguard fit --vehicle mycar.toml DRIVES -o out/fit")
def fit(
    vehicle: Vehicle,
    drives: Annotated[Path, typer.Argument(help="Folder of drives with experiments.csv.")],
    out: Out,
    accept_unusual: Annotated[
        bool, typer.Option("--accept-unusual", help="Accept a model beyond the stated kind of vehicle.")
    ] = False,
    recentre: Annotated[
        bool,
        typer.Option(
            "--recentre", help="Fit the error's share of the output over speed and frequency, where it pays."
        ),
    ] = False,
    json_out: JsonOut = None,
) -> None:
    """Fit the model's parameters, delay and offsets; writes the project file anew beside the old one.

    Names wrong signs, units, columns and delays. Exit status 1: the fit is written, and there are findings.
    """
    from ..fit.fitted_model import fit as stage
    from ..fit.fitted_model import save
    from ..fit.project_file import text_of

    project = project_of(vehicle, drives)
    with progress_bar("fit") as tell:
        result = stage(project, drives, tell, accept_unusual, recentre)
        save(result, text_of(vehicle), vehicle, out, {"measured.svg": _picture(result)})
    emit(json_out, result.to_dict())
    print_fit(result)
    console.print(f"written to {out}; next: lpvguard identify --vehicle {out}/{project.name}.toml {drives}")
    if result.findings:
        raise typer.Exit(1)


def _picture(result: FittedModel) -> str:
    """Measured and nominal output of the drives' most excited stretches, those that were not fitted first."""
    from ..fit.stretches import liveliest
    from ..report.pictures.drawing import standalone
    from ..report.pictures.over_time import Stretch, model_in_time
    from ..vehicle.nominal import NominalModel

    model, stretches = NominalModel(result.project), []
    for d in [*result.unseen, *result.drives][:PICTURED]:
        yhat = model.simulate(d.v, d.u, d.y[0])
        s = liveliest(d, round(PICTURED_S / model.Ts))
        title = f"{d.name}, {d.v[s].mean():.3g} m/s"
        stretches.append(Stretch(title, d.t[s], d.v[s], d.y[s], yhat[s]))
    return standalone(model_in_time("fit", stretches, result.project.outputs))
