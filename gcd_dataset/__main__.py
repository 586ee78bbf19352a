"""``python -m gcd_dataset`` is ``gcd``."""

import sys

from gcd_dataset.cli import main

if __name__ == "__main__":
    sys.exit(main())
