"""A stranger's first step. In: logs, with a CAN database where they are raw frames. Out: which signals are
speed, input and output, with units, signs and the reason for each; a commented project file, its signal map
and the folder of drives. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "can", "drives")
