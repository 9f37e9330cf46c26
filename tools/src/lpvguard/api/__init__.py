"""The Python interface: what the command line does, as functions that return tables and objects. In:
vehicles, folders and files, samples. Out: tables (pandas), objects of python-control, verdicts sample by
sample. It computes nothing itself. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "drives", "core", "identify", "control", "replay", "report")
