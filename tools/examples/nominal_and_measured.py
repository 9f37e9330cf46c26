"""Measured output beside the nominal model's, for twenty seconds of a drive.

python nominal_and_measured.py VEHICLE CODE DRIVE PICTURE.svg
"""

import sys

import lpvguard

run = lpvguard.replay_drive(sys.argv[1], sys.argv[3], coefficients=sys.argv[2])
print(run.series.describe().loc[["mean", "std"]].iloc[:, :4].to_string(float_format="%.3g"))
lpvguard.plots.in_time(run, 20.0, 40.0).save(sys.argv[4])
