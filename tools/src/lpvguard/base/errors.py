"""Errors that a user can act on. The command line prints them in one line and sets an exit status."""


class InputError(ValueError):
    """Bad input: what is wrong, where, and what was expected (exit status 2).

    Parameters
    ----------
    source : object, file or other origin
    where : str, line, column or field
    what : str, the fault
    expected : str, optional

    Examples
    --------
    >>> str(InputError("drive.csv", "line 7, column v", "NaN", "a finite number in m/s"))
    'drive.csv: line 7, column v: NaN; expected a finite number in m/s'
    """

    def __init__(self, source: object, where: str, what: str, expected: str | None = None):
        self.source, self.where, self.what, self.expected = str(source), where, what, expected
        parts = [p for p in (self.source, where, what) if p]
        super().__init__(": ".join(parts) + (f"; expected {expected}" if expected else ""))

    def __reduce__(self):
        """Let the error return from a worker process unchanged."""
        return InputError, (self.source, self.where, self.what, self.expected)


class InputWarning(UserWarning):
    """A part of the input was left out: what, where and why."""
