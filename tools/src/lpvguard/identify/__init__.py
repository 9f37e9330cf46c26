"""From drives to a stored identification (paper, steps 1-7).

The inputs are `Drive`s and a `Project`. The results are bounds, fitted weights, calibrated tests and the
visibility. `run.save` writes them, `run.load` proves them again, and `export` turns them into a generated
folder.
"""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "fit", "core")
