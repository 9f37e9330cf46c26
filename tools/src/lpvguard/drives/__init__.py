"""What was driven. In: drive tables, or raw logs with a signal map. Out: `Drive` on a uniform grid, and
frames of the nominal error: Hann (`frames`) or the paper's plain DFT (`dft`). Faults are put into drives
here, and the synthetic car drives here. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "can")
