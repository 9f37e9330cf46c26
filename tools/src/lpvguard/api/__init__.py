"""The Python interface: the commands of the command line as functions that return tables and objects.

In: vehicles, folders, files and samples. Out: tables (pandas), objects of python-control, and a verdict for
each sample. Other packages do all computations.
"""

MAY_IMPORT = ("base", "vehicle", "drives", "core", "identify", "control", "replay", "report")
