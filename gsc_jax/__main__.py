"""`python -m gsc_jax` is `gsc-jax`, but for an interruption while this package is imported."""

import sys

from gsc_jax.app.cli import main

sys.exit(main())
