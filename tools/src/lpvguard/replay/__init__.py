"""Replay of recorded data through the compiled core.

In: drive tables, or raw CAN logs through the core's own receiver. Out: verdicts, judged frames and alarms of
a drive.
"""

MAY_IMPORT = ("base", "vehicle", "can", "drives", "core", "identify")
