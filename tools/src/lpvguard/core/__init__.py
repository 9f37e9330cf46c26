"""Python interface to the C core.

In: model, estimator, weights and tests as numbers, and a controller. Out: the generated folder of a vehicle
and the compiled core: `Core` on the PC, `targets` on emulated ECUs.
"""

MAY_IMPORT = ("base", "vehicle", "engine", "can", "drives")
