"""Evidence of editing from the attributes of the Gaussians alone, without a 2D detector."""
