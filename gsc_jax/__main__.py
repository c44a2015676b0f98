"""`python -m gsc_jax` is `gsc-jax`."""

import sys

from gsc_jax.app.cli import main

sys.exit(main())
