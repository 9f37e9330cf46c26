"""The page and pictures for people.

In: the results of all rooms below. Out: one self-contained page, and its pictures as SVG.
"""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "fit", "core", "identify", "replay", "evaluate")
