"""Sheets of spreadsheets (.xlsx, .xls, .ods) as text tables: extra ``lpvguard[sources]``."""

import io
from pathlib import Path
from typing import Any

from ..base.errors import InputError
from .text_tables import TextTable, read_text_table

SHEET_SUFFIXES = {".xlsx", ".xlsm", ".xls", ".ods"}


def read_sheet(data: bytes, path: Path) -> TextTable:
    """Read the sheet with the most rows, as a text table with a header.

    Parameters
    ----------
    data : bytes, of the file
    path : Path, named in errors

    Returns
    -------
    TextTable

    Raises
    ------
    InputError
        If python-calamine is missing, the file cannot be read, or no sheet holds a table.
    """
    try:
        from python_calamine import CalamineWorkbook
    except ImportError as error:
        raise InputError(
            path, "", f"reading it needs the package {error.name}", "pip install 'lpvguard[sources]'"
        ) from None
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        sheets = [book.get_sheet_by_index(k).to_python() for k in range(len(book.sheet_names))]
    except Exception as error:  # the library has exceptions of its own
        raise InputError(
            path, "", f"cannot be read ({type(error).__name__}: {error})", "a whole spreadsheet"
        ) from None
    rows = max(sheets, key=len, default=[])
    return read_text_table("\n".join("\t".join(map(_text, row)) for row in rows).encode(), path)


def _text(cell: Any) -> str:
    """A cell as text: times as ISO 8601."""
    return cell.isoformat() if hasattr(cell, "isoformat") else " ".join(str(cell).split())
