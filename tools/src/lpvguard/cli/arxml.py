"""`lpvguard arxml`: a vehicle's monitor as an AUTOSAR software component."""

from ..base import artefacts
from .shared import Coefficients, Out, Vehicle, app, console, project_of


@app.command(epilog="Example: lpvguard arxml --vehicle g80 -o component")
def arxml(vehicle: Vehicle, out: Out, coefficients: Coefficients = None) -> None:
    """Write a vehicle's monitor as an AUTOSAR software component: ARXML and C source."""
    from ..core.compiled import generated_folder
    from ..extras.arxml.component import monitor_component

    project = project_of(vehicle)
    folder = generated_folder(project, coefficients, vehicle)
    files = monitor_component(project, folder)
    with artefacts.new_folder(out, "component", project.name) as work:
        artefacts.write_files(
            work, files | {"MANIFEST.json": artefacts.manifest("component", vehicle=project.name)}
        )
    console.print(f"{project.name}: {', '.join(files)} written to {out}")
