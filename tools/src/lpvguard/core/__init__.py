"""The C core seen from Python.

In: a model, an estimator, weights and tests as plain numbers; a controller. Out: the generated folder of a
vehicle, and its compiled form: `Core` on the PC, `targets` on emulated ECUs.
"""

MAY_IMPORT = ("base", "vehicle", "engine", "can", "drives")
