"""Section "Which part differs": the table of faults that can be isolated (THEORY 7.21)."""

from html import escape

from ...identify.isolation import Isolation
from ...vehicle.project import Project
from ..markup import html_rows


def isolation_section(isolation: Isolation, project: Project) -> str:
    """Return the section of an identification with [isolation]."""
    rows = ({escape(k): escape(v) for k, v in row.items()} for row in isolation.isolable_rows(project))
    return f"""<h2>Which part differs</h2><p>Least size of a fault that {isolation.window_s:g} s of usual \
driving distinguish from a fault of each other part: a share, or in the unit of its row. A star: structure \
distinguishes them too. A dash: no size is enough. "healthy": least size that differs from a healthy \
vehicle. Last columns: a usual fault, and the driving that distinguishes it from every other part.</p>
{html_rows(rows)}"""
