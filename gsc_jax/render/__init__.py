"""Projection, tiles, spherical harmonics, camera orbits: the parts of the rasteriser."""
