"""What every room stands on: errors that name what, where and what was expected; files written whole or not
at all; kernels compiled on first use; one map over items, here, over processes or over machines; samples by
hash; the layout of the core's coefficients. In: nothing of the project. Out: tools that know no vehicle.
Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ()
