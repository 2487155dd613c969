"""The hands that come with the package: one YAML file each."""

import difflib
from functools import lru_cache

from xdex_drake.data_files import data_folder
from xdex_drake.errors import UnknownHand
from xdex_drake.hand.description import Hand
from xdex_drake.hand.yaml_file import read_hand


def list_hands() -> tuple[str, ...]:
    """Names of the library's hands, in alphabetical order."""
    return tuple(sorted(path.stem for path in data_folder("hands").glob("*.yaml")))


@lru_cache(maxsize=32)
def shipped_hand(name: str) -> Hand:
    """A hand of the package.

    Args:
        name: Its name, one of `list_hands`.

    Returns:
        The hand, read once.

    Raises:
        UnknownHand: There is no such hand.
    """
    names = list_hands()
    if name not in names:
        close = difflib.get_close_matches(name.lower(), names, n=3, cutoff=0.4)
        mend = f"did you mean {' or '.join(close)}?" if close else f"known are {', '.join(names) or 'none'}"
        raise UnknownHand(
            f"there is no hand {name!r}; {mend} (a path to a .yaml or .urdf file also works, and g0-0137 is a "
            "generated hand)"
        )
    return read_hand(data_folder("hands") / f"{name}.yaml")
