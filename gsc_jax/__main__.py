"""`python -m gsc_jax` is `gsc-jax`."""

import sys

from gsc_jax_command import main

sys.exit(main())
