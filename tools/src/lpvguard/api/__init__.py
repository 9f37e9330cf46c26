"""The Python interface: the verbs of the command line as functions that return tables and objects.

In: vehicles, folders and files, samples. Out: tables (pandas), objects of python-control, verdicts sample by
sample. It computes nothing itself.
"""

MAY_IMPORT = ("base", "vehicle", "drives", "core", "identify", "control", "replay", "report")
