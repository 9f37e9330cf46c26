"""The report page and its pictures.

In: an identification, drives, and the results of other commands. Out: one self-contained HTML page, and its
pictures as SVG.
"""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "fit", "core", "identify", "replay", "evaluate")
