"""From an identification to a certified controller (paper, step 8).

The input is a stored identification; exact results also need its drives. The output is controller.json with
its certificates, Table II, the numbers of Figs. 5 and 6, and trade-offs.
"""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "core", "identify")
