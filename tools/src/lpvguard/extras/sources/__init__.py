"""Measured data from public repositories.

In: a table of data sets and files of the repositories that it names. Out: folders of drives or logs, byte for
byte those with the table's hashes.
"""

MAY_IMPORT = ("base",)
