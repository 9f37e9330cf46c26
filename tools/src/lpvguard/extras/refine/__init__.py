"""From alarms to a better model: judges further drives, proposes what to learn, and learns what is signed.

In: an identification with its drives, further drives and records of the ECU's evidence ring. Out: a file of
decisions for a person; from the signed file a new identification with its drives, and both side by side.
"""

MAY_IMPORT = ("base", "vehicle", "drives", "fit", "core", "identify", "replay", "report", "fleet")
