"""The hands of the library, by name; any other hand, by its file."""

import difflib
from functools import lru_cache
from pathlib import Path

from xdex_drake.data_files import data_folder
from xdex_drake.errors import HandFileError, UnknownHand
from xdex_drake.hand.description import Hand
from xdex_drake.hand.yaml_file import read_hand

FORMATS = (".yaml", ".yml")
ROBOT_FORMATS = (".urdf", ".xml", ".mjcf", ".sdf", ".xacro")


def list_hands() -> tuple[str, ...]:
    """Names of the library's hands, in alphabetical order."""
    return tuple(sorted(path.stem for path in data_folder("hands").glob("*.yaml")))


def load_hand(name_or_path: str | Path) -> Hand:
    """Loads a hand.

    Args:
        name_or_path: Name of a hand of the library (`list_hands`), name of a generated hand (`g0-0137`: seed 0, index
            137), or a path to a `.yaml` file, or to a URDF, MJCF or SDFormat file, which is imported as it is
            (`xdex_drake.hand.importing.files`) and kept in the cache.

    Returns:
        The hand.

    Raises:
        UnknownHand: No hand of the library has this name.
        HandFileError: The file cannot be used.
    """
    text = str(name_or_path)
    suffix = Path(text).suffix.lower()
    if suffix in FORMATS:
        return read_hand(text)
    if suffix in ROBOT_FORMATS:
        from xdex_drake.hand.importing.files import load_imported_hand

        return load_imported_hand(text)
    if isinstance(name_or_path, Path) or "/" in text or suffix:
        raise HandFileError(
            f"{text}: this is no hand file; give a .yaml or .urdf file or one of {', '.join(list_hands())}"
        )
    from xdex_drake.hand.generation import generated_hand, read_hand_name

    generated = read_hand_name(text)
    if generated is not None:
        return generated_hand(*generated)
    names = list_hands()
    if text not in names:
        close = difflib.get_close_matches(text.lower(), names, n=3, cutoff=0.4)
        mend = f"did you mean {' or '.join(close)}?" if close else f"known are {', '.join(names) or 'none'}"
        raise UnknownHand(
            f"there is no hand {text!r}; {mend} (a path to a .yaml or .urdf file also works, and g0-0137 is a "
            "generated hand)"
        )
    return _load_from_library(text)


@lru_cache(maxsize=32)
def _load_from_library(name: str) -> Hand:
    return read_hand(data_folder("hands") / f"{name}.yaml")
