"""What `splat` stands on: spherical harmonics, projection, tiles, cameras around a scene."""
