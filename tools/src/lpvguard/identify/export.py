"""Stage 6: export the generated folder of a stored identification."""

from pathlib import Path

from ..base import artefacts
from ..core.coefficients import vehicle_files
from ..core.control_coefficients import ControllerCoefficients
from .identification import ISOLATION, StoredIdentification
from .isolation_table import isolation_table, parts_header

SHORT_HASH = 16
"""Number of digits of a drive's SHA-256 in the manifest of a generated folder."""


def export_vehicle(
    stored: StoredIdentification, target: Path, controller: ControllerCoefficients | None = None
) -> None:
    """Write the generated folder of an identification, either completely or not at all.

    Parameters
    ----------
    stored : StoredIdentification
    target : Path, new folder
    controller : ControllerCoefficients, optional

    Raises
    ------
    InputError
        If the folder may not be replaced, or a part is not valid.
    """
    coefficients, manifest = stored.coefficients, stored.manifest
    hashes, names = manifest["sha256"], manifest["drives"]["bounds"]
    bound_setting = [hashes[name][:SHORT_HASH] for name in names]
    weights = {
        name: [{key: w[key] for key in ("weight", "omega_rad_s", "bound")} for w in stored.weights[name]]
        for name in ("W_delta", "W_delta_healthy")
        if name in stored.weights
    }
    energy = stored.energy_of_core.to_dict()
    provenance = {
        "kind": "vehicle",
        "identification": {"seal": manifest["seal"], "bound_setting": bound_setting},
        "energy_test": {k: v for k, v in energy.items() if k not in ("calibration", "certificate")},
        "final_inflation": stored.weights["inflation"],
        "weights": weights,
        "project": stored.project.model_dump(by_alias=True),
    }
    table = None if stored.diagnosis is None else stored.diagnosis.table
    project, isolation = stored.project, stored.isolation
    parts = None
    if isolation is not None:
        parts = (isolation_table(project, isolation), parts_header(project, isolation))
    with artefacts.new_folder(target, "vehicle", project.name) as folder:
        files = vehicle_files(project, coefficients, provenance, controller, table, parts)
        if isolation is not None:
            files[ISOLATION] = artefacts.to_json(isolation.to_dict())
        artefacts.write_files(folder, files)
