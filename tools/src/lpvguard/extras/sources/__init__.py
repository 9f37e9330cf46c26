"""Measured data from where they were published. In: a table of data sets and files of the public repositories
that it names. Out: folders of drives or logs, byte for byte those that the table has hashes of. Which rooms
it may import: MAY_IMPORT."""

MAY_IMPORT = ("base",)
