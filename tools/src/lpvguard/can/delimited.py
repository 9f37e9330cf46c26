"""Read CSV files with a byte-order mark, comment lines before the header, or `;` with decimal commas."""

import io
from collections.abc import Iterable
from itertools import islice

import pyarrow as pa
import pyarrow.csv as pa_csv


def read_csv(data: bytes, null_values: Iterable[str] | None = None) -> tuple[pa.Table, int]:
    """Read a CSV file of one of the usual dialects.

    Empty lines and lines with # before the header are skipped. If the header has more `;` than commas, `;` is
    the delimiter. The decimal mark may then be a comma.

    Parameters
    ----------
    data : bytes, content of the file
    null_values : Iterable of str, optional, texts that mean a missing value

    Returns
    -------
    tuple of Table and int, number of lines before the header

    Raises
    ------
    ArrowInvalid
        If pyarrow cannot read it.
    """
    text = data.removeprefix(b"\xef\xbb\xbf")
    skipped, position = 0, 0
    while position < len(text):
        end = text.find(b"\n", position)
        line = text[position : end if end >= 0 else len(text)].strip()
        if line and not line.startswith(b"#"):
            break
        position = end + 1 if end >= 0 else len(text)
        skipped += 1
    end = text.find(b"\n", position)
    header = text[position : end if end >= 0 else len(text)]
    try:
        header.decode("utf-8")
    except UnicodeDecodeError as error:
        raise pa.ArrowInvalid(f"the header is no UTF-8: {error}") from None
    delimiter = ";" if header.count(b";") > header.count(b",") else ","
    body = io.BytesIO(text[position:] if position else text)
    convert = pa_csv.ConvertOptions(decimal_point="," if _decimal_commas(body, delimiter) else ".")
    if null_values is not None:
        convert.null_values, convert.strings_can_be_null = list(null_values), True
    table = pa_csv.read_csv(
        body, parse_options=pa_csv.ParseOptions(delimiter=delimiter), convert_options=convert
    )
    return table.rename_columns([name.strip() for name in table.column_names]), skipped


def _decimal_commas(body: io.BytesIO, delimiter: str) -> bool:
    """Tell from the lines after the header if numbers have a decimal comma; only with the delimiter `;`."""
    lines = list(islice(body, 1, 20))
    body.seek(0)
    return delimiter == ";" and any(b"," in line for line in lines) and not any(b"." in x for x in lines)
