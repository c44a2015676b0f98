"""The pieces of the 3D viewer: what it shows, from where, and its panels."""
