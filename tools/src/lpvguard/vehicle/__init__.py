"""One vehicle as its project file describes it.

In: a project file (`shipped/*.toml` are data of this room). Out: the checked `Project`, and `NominalModel`
with matrices over speed, delay and the recursion along a drive.
"""

MAY_IMPORT = ("base",)
