"""The tools that every room uses: errors, files, compiled kernels, parallel maps, sampling, coefficient
layout.

The room imports nothing of the project and knows no vehicle.
"""

MAY_IMPORT = ()
