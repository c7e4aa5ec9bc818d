"""`python -m mjframes` is the command `mjframes`."""

import sys

from mjframes.cli.commands import main

if __name__ == "__main__":
    sys.exit(main())
