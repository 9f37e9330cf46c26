"""Vehicle described by its project file.

In: a project file (`shipped/*.toml` belong to this package). Out: the checked `Project`, and the
`NominalModel` with matrices over speed, input delay and simulation along a drive.
"""

MAY_IMPORT = ("base",)
