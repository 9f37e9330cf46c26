"""Read the positions of an object's fields from the debug information (DWARF) of an image (ELF)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from ...base.errors import InputError

_WRAPPERS = {"DW_TAG_typedef", "DW_TAG_const_type", "DW_TAG_volatile_type"}
_FLOAT, _SIGNED, _BOOLEAN = 0x04, (0x05, 0x06), 0x02
"""Kind of a base type by its DW_ATE_*; all others are unsigned."""
_OP_ADDR = 0x03


@dataclass(frozen=True)
class PlacedField:
    """A field with a value, at ``path`` (`.monitor.bin[3].n`) and ``offset`` in the object.

    ``struct`` declares the field as ``name``. An element has ``bytes`` and a ``kind``: float, signed,
    unsigned or bool. ``dims`` are the sizes of the array, () for a single element. ``enum`` is the name of
    its enumeration, None for a number.
    """

    path: str
    struct: str
    name: str
    offset: int
    bytes: int
    kind: str
    enum: str | None
    dims: tuple[int, ...]


@dataclass(frozen=True)
class Instance:
    """An object of an image: its ``symbol``, its ``struct``, ``address`` and ``bytes``.

    ``big_endian`` is the byte order of the image. ``fields`` holds the fields with a value, sorted by offset.
    ``pointers`` holds (offset, bytes) of pointers, which are not measured.
    """

    symbol: str
    struct: str
    address: int
    bytes: int
    big_endian: bool
    fields: tuple[PlacedField, ...]
    pointers: tuple[tuple[int, int], ...]


def read_instance(elf: Path, symbol: str, structs: tuple[str, ...]) -> Instance:
    """Read the object ``symbol`` of an image; its type must be one of ``structs``.

    Raises InputError if the file is not an ELF file or has no debug information. Raises it also if the image
    has no such object, several of them, or one of another type.
    """
    try:
        with elf.open("rb") as stream:
            image = ELFFile(stream)
            if not image.has_dwarf_info(strict=True):
                raise InputError(elf, "", "no debug information", "an image compiled with -g, not stripped")
            return _instance(elf, image, symbol, structs)
    except OSError as error:
        raise InputError(
            elf, "", f"cannot be read ({error.strerror})", "the image of the ECU, an ELF"
        ) from None
    except ELFError as error:
        raise InputError(elf, "", f"no ELF ({error})", "the image of the ECU, an ELF") from None


def _instance(elf: Path, image: ELFFile, symbol: str, structs: tuple[str, ...]) -> Instance:
    kinds: dict[int, Any] = {}
    others: set[str] = set()
    for address, names, die in _variables(image):
        kind = _resolved(die) if "DW_AT_type" in die.attributes else None
        if kind is not None and _name(kind) in structs:
            others |= names
            if symbol in names:
                kinds[address] = kind
        elif symbol in names:
            what = "no type" if kind is None else _name(kind) or kind.tag
            raise InputError(elf, symbol, f"is {what}", f"an object of {' or '.join(structs)}")
    if len(kinds) != 1:
        what = "no such object" if not kinds else f"{len(kinds)} objects of that name"
        expected = (
            f"one of {', '.join(sorted(others))}"
            if others
            else f"a variable of {' or '.join(structs)}, compiled with -g"
        )
        raise InputError(elf, symbol, what, expected)
    ((address, kind),) = kinds.items()
    fields, pointers = [], []
    for item in _walk(kind, "", 0):
        if isinstance(item, PlacedField):
            fields.append(item)
        else:
            pointers.append(item)
    return Instance(
        symbol,
        _name(kind),
        address,
        kind.attributes["DW_AT_byte_size"].value,
        not image.little_endian,
        tuple(fields),
        tuple(pointers),
    )


def _variables(image: ELFFile) -> Iterator[tuple[int, set[str], Any]]:
    """Address, names and declaration of every variable with a fixed address in the linked image."""
    kept = {
        symbol["st_value"]
        for section in (image.get_section_by_name(".symtab"),)
        if isinstance(section, SymbolTableSection)
        for symbol in section.iter_symbols()
        if symbol["st_info"]["type"] == "STT_OBJECT" and symbol["st_shndx"] != "SHN_UNDEF"
    }
    width = image.elfclass // 8
    for unit in image.get_dwarf_info().iter_CUs():
        for die in unit.iter_DIEs():
            place = die.attributes.get("DW_AT_location")
            if die.tag != "DW_TAG_variable" or place is None or not isinstance(place.value, list):
                continue
            if place.value[:1] != [_OP_ADDR] or len(place.value) != 1 + width:
                continue
            address = int.from_bytes(bytes(place.value[1:]), "little" if image.little_endian else "big")
            declaration = die
            while "DW_AT_specification" in declaration.attributes:
                declaration = declaration.get_DIE_from_attribute("DW_AT_specification")
            names = {
                at.attributes[key].value.decode()
                for at in (die, declaration)
                for key in ("DW_AT_name", "DW_AT_linkage_name")
                if key in at.attributes
            }
            if address in kept:
                yield address, names, declaration


def _name(die: Any) -> str:
    named = die.attributes.get("DW_AT_name")
    return named.value.decode() if named is not None else ""


def _resolved(die: Any) -> Any:
    """The type of a declaration without typedefs and qualifiers."""
    kind = die.get_DIE_from_attribute("DW_AT_type")
    while kind.tag in _WRAPPERS:
        kind = kind.get_DIE_from_attribute("DW_AT_type")
    return kind


def _walk(struct: Any, path: str, offset: int) -> Iterator[PlacedField | tuple[int, int]]:
    """Fields with a value, and (offset, bytes) of pointers, in a struct, sorted by offset."""
    for member in struct.iter_children():
        if member.tag != "DW_TAG_member":
            continue
        name = _name(member)
        kind, dims = _resolved(member), ()
        if kind.tag == "DW_TAG_array_type":
            dims = tuple(
                child.attributes["DW_AT_upper_bound"].value + 1
                for child in kind.iter_children()
                if child.tag == "DW_TAG_subrange_type"
            )
            kind = _resolved(kind)
        place = offset + member.attributes["DW_AT_data_member_location"].value
        size = kind.attributes["DW_AT_byte_size"].value
        if kind.tag == "DW_TAG_structure_type":
            for i, index in enumerate(_indices(dims)):
                yield from _walk(kind, f"{path}.{name}{index}", place + i * size)
        elif kind.tag == "DW_TAG_pointer_type":
            for i, _ in enumerate(_indices(dims)):
                yield place + i * size, size
        else:
            enum = _name(kind) or None if kind.tag == "DW_TAG_enumeration_type" else None
            yield PlacedField(f"{path}.{name}", _name(struct), name, place, size, _kind(kind), enum, dims)


def _kind(kind: Any) -> str:
    encoding = kind.attributes["DW_AT_encoding"].value if "DW_AT_encoding" in kind.attributes else None
    if encoding == _FLOAT:
        return "float"
    if encoding == _BOOLEAN:
        return "bool"
    return "signed" if encoding in _SIGNED else "unsigned"


def _indices(dims: tuple[int, ...]) -> list[str]:
    """Index text `[i][j]` of every array element in the order of memory; one empty text for a scalar."""
    texts = [""]
    for n in dims:
        texts = [f"{text}[{i}]" for text in texts for i in range(n)]
    return texts
