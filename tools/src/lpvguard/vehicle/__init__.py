"""One vehicle as its project file states it. In: a project file (`shipped/*.toml` are data of this room).
Out: `Project`, checked, and `NominalModel`: matrices over speed, delay, the recursion along a drive. Which
rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base",)
