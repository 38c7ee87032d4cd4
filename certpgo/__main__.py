"""``python -m certpgo``: the command line."""

import sys

from certpgo.cli import main

if __name__ == "__main__":
    sys.exit(main())
