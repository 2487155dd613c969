"""Reads XML that a stranger wrote: plain elements only, within limits, and never another file."""

import math
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from xdex_drake.arrays import Array
from xdex_drake.errors import HandFileError

MAX_BYTES = 20_000_000
MAX_ELEMENTS = 200_000
MAX_DEPTH = 100
MAX_LINKS = 500
LARGEST_NUMBER = 1e9


def read_xml(path: Path, what: str, *, max_bytes: int = MAX_BYTES, max_elements: int = MAX_ELEMENTS) -> Element:
    """Reads an XML file without a document type, entities or inclusions.

    Namespaces are not resolved: a tag `drake:capsule` stays as it is written, declared or not.

    Args:
        path: The file.
        what: What it should be, for messages, such as "a URDF file".
        max_bytes: Greatest size of the file.
        max_elements: Greatest number of elements.

    Returns:
        The root element.

    Raises:
        HandFileError: The file cannot be read, is not XML, declares entities, or exceeds a limit.
    """
    try:
        if path.is_dir():
            raise HandFileError(f"{path}: is a folder; give {what}")
        if not path.is_file():
            raise HandFileError(f"{path}: no such file; check the path")
        size = path.stat().st_size
        if size > max_bytes:
            raise HandFileError(f"{path}: has {size} bytes, more than {max_bytes}; give {what} without embedded data")
        data = path.read_bytes()
    except OSError as error:
        raise HandFileError(f"{path}: cannot be read ({error.strerror}); check the path and its rights") from None
    if not data.strip():
        raise HandFileError(f"{path}: is empty; give {what}")
    return parse_xml(data, str(path), what, max_elements=max_elements)


def parse_xml(data: bytes, source: str, what: str, *, max_elements: int = MAX_ELEMENTS) -> Element:
    """Parses XML as `read_xml` does.

    Args:
        data: The text, in the encoding that it declares.
        source: Where it comes from, for messages.
        what: What it should be, for messages.
        max_elements: Greatest number of elements.

    Returns:
        The root element.

    Raises:
        HandFileError: It is not XML, declares entities, or exceeds a limit.
    """
    builder = TreeBuilder()
    parser = expat.ParserCreate()
    depth = count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH:
            raise HandFileError(
                f"{source}: line {parser.CurrentLineNumber} is nested deeper than {MAX_DEPTH} elements; give {what}"
            )
        if count > max_elements:
            raise HandFileError(f"{source}: has more than {max_elements} elements; give a file of the hand alone")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse_doctype(name: str, *_: object) -> None:
        raise HandFileError(
            f"{source}: line {parser.CurrentLineNumber} declares a document type ({name:.40}), which can hide entities "
            "and other files; remove the <!DOCTYPE ...> lines"
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse_doctype
    try:
        parser.Parse(data, True)
        return builder.close()
    except expat.ExpatError as error:
        said = " ".join(str(error).split())
        raise HandFileError(f"{source}: is not valid XML ({said}); give {what}") from None
    except (ValueError, LookupError, AssertionError) as error:  # An encoding that does not exist, for one.
        said = " ".join(str(error).split())[:120]
        raise HandFileError(f"{source}: cannot be read as XML ({said}); give {what} in UTF-8") from None


class Place:
    """An element together with its file and where it stands, for messages."""

    def __init__(self, element: Element, source: str, place: str) -> None:
        self.element, self.source, self.place = element, source, place

    def fail(self, what: str, mend: str) -> HandFileError:
        """The error that this element is wrong."""
        return HandFileError(f"{self.source}: {self.place} {what}; {mend}")

    def child(self, tag: str) -> "Place | None":
        """The first child with a tag."""
        found = self.element.find(tag)
        return None if found is None else Place(found, self.source, f"<{tag}> of {self.place}")

    def text(self, attribute: str) -> str:
        """An attribute that must be there and not be empty."""
        value = self.element.get(attribute)
        if value is None or not value.strip():
            raise self.fail(f"has no attribute {attribute!r}", "add it")
        return value.strip()

    def numbers(self, attribute: str, count: int, default: Array | None = None) -> Array:
        """An attribute of several numbers, shape (count,)."""
        text = self.element.get(attribute)
        if text is None:
            if default is None:
                raise self.fail(f"has no attribute {attribute!r}", f"give {count} numbers")
            return np.asarray(default, dtype=np.float64).copy()
        values = self.list_of_numbers(attribute)
        if len(values) != count:
            raise self.fail(f"has {attribute}={text[:60]!r}, {len(values)} numbers", f"give {count}")
        return values

    def list_of_numbers(self, attribute: str) -> Array:
        """An attribute of any count of numbers; none where it is absent."""
        words = self.element.get(attribute, "").split()
        return np.array([self._number(word, attribute, allow_infinite=False) for word in words])

    def number(self, attribute: str, default: float | None = None, *, allow_infinite: bool = False) -> float:
        """An attribute of one number."""
        text = self.element.get(attribute)
        if text is None:
            if default is None:
                raise self.fail(f"has no attribute {attribute!r}", "give a number")
            return default
        return self._number(text, attribute, allow_infinite=allow_infinite)

    def _number(self, text: str, attribute: str, *, allow_infinite: bool) -> float:
        try:
            value = float(text)
        except ValueError:
            raise self.fail(f"has {attribute}={text[:40]!r}", "write a number") from None
        if math.isnan(value) or (abs(value) > LARGEST_NUMBER and not (allow_infinite and math.isinf(value))):
            raise self.fail(f"has {attribute}={text[:40]!r}", "write a finite number in SI units")
        return value


def check_names(names: list[str], kind: str, source: str, *, largest: int = MAX_LINKS) -> None:
    """Refuses too many elements of a kind, and two of the same name.

    Raises:
        HandFileError: One of these.
    """
    if len(names) > largest:
        raise HandFileError(f"{source}: has {len(names)} {kind}s, more than {largest}; give a file of the hand alone")
    seen = set()
    for name in names:
        if name in seen:
            raise HandFileError(f"{source}: has two {kind}s named {name!r}; rename one")
        seen.add(name)
