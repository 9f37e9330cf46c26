"""The first step with a new vehicle.

In: logs, with a CAN database where they are raw frames. Out: the signals for speed, input and output, with
units, signs and the reason for each. Also out: a commented project file, its signal map, the folder of
drives.
"""

MAY_IMPORT = ("base", "vehicle", "can", "drives")
