"""The verbs in the order of a user's work, as `lpvguard --help` lists them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from typer.core import TyperGroup

if TYPE_CHECKING:
    from click import Context, HelpFormatter

SECTIONS = {
    "Start": ("new", "ingest", "data"),
    "Main path": ("fit", "identify", "design", "export", "replay", "evaluate", "report"),
    "Vehicle in a loop": ("generate", "sim", "campaign", "lcm", "plant"),
    "Fleet and live": ("fleet", "refine", "live"),
    "Bus and ECU": ("dbc", "a2l", "fmu", "arxml"),
    "Bench and problems": ("bench", "solve"),
    "Shell": ("completion",),
}
"""Verbs by title; every verb is in one section."""
SUMMARY = 200
"""The longest summary of a verb, in characters; a longer one is cut."""


class Sections(TyperGroup):
    """The verbs under the titles of SECTIONS."""

    def list_commands(self, ctx: Context) -> list[str]:  # type: ignore[override]  # Typer's own copy of click
        """Names of the verbs, section by section."""
        return [verb for verbs in SECTIONS.values() for verb in verbs]

    def format_commands(self, ctx: Context, formatter: HelpFormatter) -> None:  # type: ignore[override]
        """Write a list of verbs for each section."""
        longest = max(map(len, self.commands))
        for title, verbs in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl(
                    [(verb.ljust(longest), self.commands[verb].get_short_help_str(SUMMARY)) for verb in verbs]
                )
