"""From an identification to a certified controller (paper, step 8). In: a stored identification, drives for
what must be exact. Out: controller.json with its certificates, Table II, the numbers of Figs. 5 and 6,
trade-offs. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "core", "identify")
