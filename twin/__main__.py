"""Run the command line with `python -m twin`."""

import sys

from twin.cli.parser import main

sys.exit(main())
