"""`python -m twin.replay PATH` is `twin replay PATH`."""

import sys

from twin.cli.replay import main

sys.exit(main())
