"""Export the generated folder of an identification with its controller, or with a group's thresholds."""

from pathlib import Path

from ..base.parallel import Map
from ..base.progress import Progress
from ..core.control_coefficients import load_controller
from ..identify import export
from ..identify.identification import StoredIdentification
from .design import verify


def export_chosen(
    stored: StoredIdentification,
    target: Path,
    controller: Path | None = None,
    group: str | None = None,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> StoredIdentification:
    """Write the generated folder, whole or not at all.

    Parameters
    ----------
    stored : StoredIdentification
    target : Path, new folder
    controller : Path, optional, controller.json or folder of `design`
        Its certificates are proved again.
    group : str, optional, group of drives whose thresholds are exported, default the largest of all groups
    progress : Callable, reports progress
    workers : Map, shares the speeds

    Returns
    -------
    StoredIdentification, as exported

    Raises
    ------
    InputError
        If a certificate fails, or if the group has no drive.
    """
    chosen = stored if group is None else stored.of_group(group)
    path = controller / "controller.json" if controller is not None and controller.is_dir() else controller
    if path is not None:
        verify(path, chosen, progress, workers)
    progress("writing")
    export.export_vehicle(chosen, target, None if path is None else load_controller(path))
    return chosen
