"""``python -m bsp_gp`` is ``bsp-gp``."""

import sys

from bsp_gp.cli import main

if __name__ == "__main__":
    sys.exit(main())
