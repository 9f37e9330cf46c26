"""The margin of every frame of a drive, over time and frequency.

python show_margins.py VEHICLE CODE DRIVE PICTURE.svg
"""

import sys

import lpvguard

run = lpvguard.replay_drive(sys.argv[1], sys.argv[3], coefficients=sys.argv[2])
print(run.frames.groupby("reason").size().to_string())
lpvguard.plots.margins(run).save(sys.argv[4])
