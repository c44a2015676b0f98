"""The estimator beyond the paper: latent classes of Gaussians and the reliability of every mask."""
