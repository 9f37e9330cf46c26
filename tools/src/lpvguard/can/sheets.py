"""Sheets of spreadsheets (.xlsx, .xls, .ods) as text tables: extra ``lpvguard[sources]``."""

import io
from pathlib import Path
from typing import Any

from ..base.optional import read_by_library
from .text_tables import TextTable, read_text_table

SHEET_SUFFIXES = {".xlsx", ".xlsm", ".xls", ".ods"}


def read_sheet(data: bytes, path: Path) -> TextTable:
    """Read the sheet with the most rows, as a text table with a header.

    Raises InputError if python-calamine is missing, the file cannot be read, or no sheet holds a table.
    """
    with read_by_library(path, "a whole spreadsheet"):
        from python_calamine import CalamineWorkbook

        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        sheets = [book.get_sheet_by_index(k).to_python() for k in range(len(book.sheet_names))]
    rows = max(sheets, key=len, default=[])
    return read_text_table("\n".join("\t".join(map(_text, row)) for row in rows).encode(), path)


def _text(cell: Any) -> str:
    """A cell as text: times as ISO 8601."""
    return cell.isoformat() if hasattr(cell, "isoformat") else " ".join(str(cell).split())
