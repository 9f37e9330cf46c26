"""From drives to a stored identification (paper, steps 1-7). In: `Drive`s and a `Project`. Out: bounds,
fitted weights, calibrated tests, visibility; `run.save` writes them, `run.load` proves them anew, `export`
turns them into a generated folder. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "fit", "core")
