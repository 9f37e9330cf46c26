"""Section "Confirmation of alarms": delay against rate of the designs k of m (THEORY 7.20)."""

from html import escape

from ...identify.confirmation import FOUND, Confirmation
from ..markup import captioned, html_rows
from ..pictures.detectors import confirmation_tradeoff


def confirmation_section(confirmation: Confirmation) -> str:
    """Return the section of an identification with a rate of alarms."""
    rows = ({escape(k): escape(v) for k, v in row.items()} for row in confirmation.table())
    picture = captioned(
        confirmation_tradeoff("k", confirmation),
        "Over the rate of alarms that the thresholds promise (dashed: the target). Left: smallest gain error "
        f"that is found within {confirmation.within_s:g} s from {FOUND:.0%} of the instants. Right: delay "
        f"until a gain error of {confirmation.shown:.2g} is found from as many. Grey: the other tests, "
        "without confirmation. A line ends where nothing is found.",
    )
    return (
        f"<h2>Confirmation of alarms</h2><p>{escape(confirmation.sentence())}</p>{picture}{html_rows(rows)}"
    )
