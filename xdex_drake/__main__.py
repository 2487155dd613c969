"""`python -m xdex_drake` is the `xdex` command."""

import sys

from xdex_drake.cli import main

if __name__ == "__main__":
    sys.exit(main())
