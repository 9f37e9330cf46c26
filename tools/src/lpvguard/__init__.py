"""lpvguard: unfalsified LPV vehicle models, robust controllers and an on-line nominal-error monitor.

One package per room, in the order of the data; ``tools/README.md`` is the map, and each room's docstring says
what comes in, what goes out and which rooms it may import.

The Python interface is the room ``api``; its names are here as well:

    found = lpvguard.identify("mycar.toml", "drives")           found.bounds, found.weights
    code = found.export("code")
    run = lpvguard.replay("mycar.toml", "drive.csv", coefficients=code)   run.series, run.frames
    said = lpvguard.Monitor("mycar.toml", code).push(t, v, u, y)          said.verdict
    lpvguard.plots.weights(found), lpvguard.plots.margins(run)            in a notebook
"""

from __future__ import annotations

import os
import types
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Same input, same bytes: threaded BLAS sums in an order that depends on the machine's load. Set before numpy
# loads.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

__version__ = "0.3.0"

if TYPE_CHECKING:
    from .api import plots as plots
    from .api.identified import Identified as Identified
    from .api.identified import identify as identify
    from .api.identified import load as load
    from .api.monitor import Monitor as Monitor
    from .api.replayed import Replayed as Replayed
    from .api.replayed import replay as replay
    from .base.errors import InputError as InputError
else:
    from . import identify, replay

    _PLACES = {
        "Identified": ".api.identified",
        "identify": ".api.identified",
        "load": ".api.identified",
        "Monitor": ".api.monitor",
        "Replayed": ".api.replayed",
        "replay": ".api.replayed",
        "InputError": ".base.errors",
    }
    """Loaded when asked for: the command line starts without them."""

    class _Verb(types.ModuleType):
        """A room that has the name of a function: called, it is that function."""

        def __call__(self, *arguments: Any, **options: Any) -> Any:
            name = self.__name__.rpartition(".")[2]
            return getattr(import_module(_PLACES[name], __name__), name)(*arguments, **options)

    identify.__class__ = replay.__class__ = _Verb

    def __getattr__(name: str) -> Any:
        if name == "plots":
            return import_module(".api.plots", __name__)
        if name not in _PLACES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_PLACES[name], __name__), name)
