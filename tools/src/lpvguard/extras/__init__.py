"""Side rooms, beside the main path from drives to verdicts. They hold the simulated loop, fleets, the live
page, problems of the numerical engine, benchmarks, A2L and public data sets. A side room imports rooms of the
main path. No room of the main path imports a side room."""
