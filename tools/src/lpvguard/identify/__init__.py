"""From drives to a stored identification (paper, steps 1-7).

In: `Drive`s and a `Project`. Out: bounds, fitted weights, calibrated tests, visibility. `run.save` writes
them, `run.load` proves them again, and `export` turns them into a generated folder.
"""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "fit", "core")
