"""The `xdex` command: parsing and printing only; what it does is done by the library."""

from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: Arguments; those of the process where None.

    Returns:
        Exit status: 0 done; 1 the work was done but found nothing; 2 bad input; 130 interrupted.
    """
    from xdex_drake.cli.app import run

    return run(argv)
