"""What people see. In: everything that the rooms below wrote. Out: one self-contained page, and its pictures
as SVG. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "engine", "drives", "fit", "core", "identify", "replay", "evaluate")
