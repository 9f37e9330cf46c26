"""lpvguard: unfalsified LPV vehicle models, robust controllers and an on-line nominal-error monitor.

One package per room, in the order of the data; ``tools/README.md`` is the map, and each room's docstring says
what comes in, what goes out and which rooms it may import.
"""

import os

# Same input, same bytes: threaded BLAS sums in an order that depends on the machine's load. Set before numpy
# loads.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

__version__ = "0.2.0"
