"""Where the library's data files are: hand descriptions and problem instances."""

from pathlib import Path

from xdex_drake.errors import ConfigError

KINDS = ("hands", "problems")


def data_folder(kind: str) -> Path:
    """Folder of the data files that ship with the library.

    In a checkout they lie at its top, where people look for them; in an installed wheel inside the package.

    Args:
        kind: "hands" or "problems".

    Returns:
        The folder. In a fresh checkout it may not exist yet.

    Raises:
        ConfigError: There is no such kind of data.
    """
    if kind not in KINDS:
        raise ConfigError(f"there is no data folder {kind!r}; use one of {', '.join(KINDS)}")
    package = Path(__file__).resolve().parent
    installed = package / "_data" / kind
    return installed if installed.is_dir() else package.parent / kind
