"""A nominal model's numbers from drives. In: `Drive`s and a `Project` whose parameters are guesses. Out: the
parameters, delay and offsets with their standard errors, and how well they explain each drive. What is wrong
with drives that no parameters explain is named. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "drives")
