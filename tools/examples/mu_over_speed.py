"""The controller of an identification with a [design] table: mu over speed, or what limits it.

python mu_over_speed.py IDENTIFICATION
"""

import sys
from pathlib import Path

from lpvguard.control.design import design, limit_sentence
from lpvguard.identify import identification

stored = identification.load(Path(sys.argv[1]))
result = design(stored, moving_speed=False)
for v, proved in result.certificates:
    print(f"{v:5.1f} m/s: {proved.lower:.3f} <= mu <= {proved.upper:.3f}")
if result.worst >= 1:
    print(limit_sentence(stored, result))
