"""The hands of the library, by name; any other hand, by its file."""

from pathlib import Path

from xdex_drake.errors import HandFileError
from xdex_drake.hand.description import Hand
from xdex_drake.hand.shipped import list_hands, shipped_hand
from xdex_drake.hand.yaml_file import read_hand

__all__ = ["FORMATS", "ROBOT_FORMATS", "list_hands", "load_hand"]

FORMATS = (".yaml", ".yml")
ROBOT_FORMATS = (".urdf", ".xml", ".mjcf", ".sdf", ".xacro")


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
    # The importer and the generator are imported only where they are asked for: most commands need neither.
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
    return shipped_hand(text)
