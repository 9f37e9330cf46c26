"""Recorded and synthetic drives.

In: drive tables, or raw logs with a signal map. Out: `Drive` on a uniform grid, and frames of the nominal
error: Hann (`frames`) or the paper's plain DFT (`dft`). The room also injects faults into drives and makes
the drives of the synthetic car.
"""

MAY_IMPORT = ("base", "vehicle", "can")
