"""The 3D viewer of `gsc-jax view`, served or written as a page."""
