"""`python -m twin.replay PATH` is `twin replay PATH`."""

import sys

from twin.replay.command import main

sys.exit(main())
