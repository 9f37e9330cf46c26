"""The bounds of an identification as a table, and its weights as a picture.

python show_bounds.py IDENTIFICATION PICTURE.svg
"""

import sys

import lpvguard

identification = lpvguard.load(sys.argv[1])
print(identification.bounds.to_string(float_format="%.3g"))
lpvguard.plots.weights(identification).save(sys.argv[2])
