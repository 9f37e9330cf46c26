"""lpvguard: unfalsified LPV vehicle models, robust controllers and an on-line nominal-error monitor.

There is one package per room, in the order of the data. ``tools/README.md`` is the map. The docstring of each
room says what comes in, what goes out and which rooms it may import.

The Python interface is the room ``api``. Its names are here as well:

    identified = lpvguard.identify_drives("mycar.toml", "drives")      identified.bounds, identified.weights
    code = identified.export("code")
    run = lpvguard.replay_drive("mycar.toml", "drive.csv", coefficients=code)   run.series, run.frames
    verdicts = lpvguard.Monitor("mycar.toml", code).push(t, v, u, y)      verdicts.verdict
    lpvguard.plots.weights(identified), lpvguard.plots.margins(run)       in a notebook
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Same input, same bytes: threaded BLAS sums in an order that depends on the machine's load. Set before numpy
# loads.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

__version__ = "0.4.0"

if TYPE_CHECKING:
    from .api import plots as plots
    from .api.drive_replay import Replayed as Replayed
    from .api.drive_replay import replay_drive as replay_drive
    from .api.identification import Identified as Identified
    from .api.identification import identify_drives as identify_drives
    from .api.identification import load as load
    from .api.monitor import Monitor as Monitor
    from .base.errors import InputError as InputError
else:
    _PLACES = {
        "Identified": ".api.identification",
        "identify_drives": ".api.identification",
        "load": ".api.identification",
        "Monitor": ".api.monitor",
        "Replayed": ".api.drive_replay",
        "replay_drive": ".api.drive_replay",
        "InputError": ".base.errors",
    }
    """Loaded when asked for: the command line starts without them."""

    def __getattr__(name: str) -> Any:
        if name == "plots":
            return import_module(".api.plots", __name__)
        if name not in _PLACES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_PLACES[name], __name__), name)
