"""`python -m mobo_tuner.runs.report RUN_FOLDER`."""

import sys

from mobo_tuner.runs.report.command import main

sys.exit(main())
