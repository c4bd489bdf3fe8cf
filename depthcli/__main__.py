"""``python -m depthcli``."""

import sys

from depthcli.cli.app import main

if __name__ == "__main__":
    sys.exit(main())
