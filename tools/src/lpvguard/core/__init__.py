"""The C core's side of Python. In: a model, an estimator, weights and tests as plain numbers; a controller.
Out: the generated folder of a vehicle, and that folder compiled: `Core` on the PC, `targets` on emulated
ECUs. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "engine", "can", "drives")
