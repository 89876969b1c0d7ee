"""`python -m playlearn.cli`."""

import sys

from playlearn.cli import main

sys.exit(main())
