"""From an identification to a certified controller (paper, step 8).

In: a stored identification, and drives for exact results. Out: controller.json with its certificates, Table
II, the numbers of Figs. 5 and 6, trade-offs.
"""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "core", "identify")
