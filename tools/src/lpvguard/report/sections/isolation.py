"""Section "Which part differs": the table of faults that can be isolated (THEORY 7.21)."""

from html import escape

from ...identify.isolation import Isolation
from ...vehicle.project import Project
from ..markup import html_rows


def isolation_section(isolation: Isolation, project: Project) -> str:
    """The section of an identification with [isolation]."""
    rows = ({escape(k): escape(v) for k, v in row.items()} for row in isolation.isolable_rows(project))
    return f"""<h2>Which part differs</h2><p>Least size of a fault that {isolation.window_s:g} s of usual \
driving tell from each other part: a share, or in the unit of its row. A star: by structure, too. A \
dash: by no size. "healthy": least size that differs at all. Last columns: a usual fault, and the \
driving that tells it from every other part.</p>
{html_rows(rows)}"""
