"""Errors of the synthesis: which assumption fails, where, and what to change."""

from __future__ import annotations

from lpvguard.base.errors import InputError


class SynthesisError(InputError):
    """A problem that cannot be answered as posed; ``expected`` says what to change."""
