"""Rebuild measured data sets from public repositories.

The input is a table of data sets, and files of the repositories in the table. The output is folders of drives
or logs whose bytes match the table's hashes.
"""

MAY_IMPORT = ("base",)
