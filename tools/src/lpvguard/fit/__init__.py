"""Fit of a nominal model to drives.

In: `Drive`s and a `Project` whose parameters are guesses. Out: the parameters, delay and offsets with their
standard errors, and the explained variance of each drive. Drives that no parameters explain get a diagnosis.
"""

MAY_IMPORT = ("base", "vehicle", "drives")
