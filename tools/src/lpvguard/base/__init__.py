"""What every room stands on.

- Errors name what, where and what was expected.
- Files are written whole or not at all.
- Kernels are compiled on first use.
- One map runs over items: here, over processes or over machines.
- Samples are drawn by hash.
- The layout of the core's coefficients has one description.

In: nothing of the project. Out: tools that know no vehicle. Which rooms it may import: MAY_IMPORT.
"""

MAY_IMPORT = ()
