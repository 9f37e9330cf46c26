"""Errors of the synthesis: the failing assumption, its place and the remedy."""

from lpvguard.base.errors import InputError


class SynthesisError(InputError):
    """A problem without an answer; ``expected`` is the remedy."""
