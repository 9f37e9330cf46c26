"""Error of the synthesis. It names the failing assumption, its place and the remedy."""

from lpvguard.base.errors import InputError


class SynthesisError(InputError):
    """The problem has no solution. ``expected`` names the remedy."""
