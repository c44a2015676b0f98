"""Colours from spherical harmonics, in the real basis and sign convention of 3DGS files.

A colour is 0.5 + sum_k Y_k(d) h_k, clamped below at 0, where d is the unit direction from the
camera to the Gaussian. The harmonics are orthonormal and include the Condon-Shortley phase, hence
the alternating signs (Kerbl et al. 2023; Sloan 2013).
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.scene import Array

Y0 = 0.28209479177387814
"""The constant harmonic, 1 / (2 sqrt(pi)): a plain colour c is stored as (c - 0.5) / Y0."""


def basis(directions: jax.Array, degree: int) -> jax.Array:
    """Evaluate the K = (degree + 1)^2 real harmonics at unit vectors (N, 3), shape (N, K)."""
    if not 0 <= degree <= 3:
        raise ValueError(f"degree of the spherical harmonics must be 0 to 3, got {degree}")
    x, y, z = jnp.moveaxis(directions, -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    bands = [
        [jnp.full_like(x, Y0)],
        [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x],
        [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
        ],
        [
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
    ]
    return jnp.stack([value for band in bands[: degree + 1] for value in band], axis=-1)


@jax.jit
def colors(sh: jax.Array, means: jax.Array, center: jax.Array) -> jax.Array:
    """Compute the RGB (N, 3) of Gaussians with these means (N, 3) as seen from a point (3,).

    The coefficients `sh` have shape (N, K, 3) with K = 1, 4, 9 or 16. The colours are not negative,
    may exceed 1, and are 0 where not finite.
    """
    degree = round(sh.shape[1] ** 0.5) - 1
    if sh.shape[1] != (degree + 1) ** 2:
        raise ValueError(f"expected 1, 4, 9 or 16 coefficients, got {sh.shape[1]}")
    # Placeholders before any arithmetic: 0 times the derivative of a NaN would be NaN.
    somewhere = jnp.all(jnp.isfinite(means), axis=1, keepdims=True)
    known = somewhere & jnp.all(jnp.isfinite(sh), axis=1)
    towards = jnp.where(somewhere, means, center[None]) - center[None]
    square = jnp.sum(towards * towards, axis=-1, keepdims=True)
    directions = towards / jnp.sqrt(jnp.where(square > 0, square, 1.0))
    rgb = jnp.maximum(0.5 + _expansion(basis(directions, degree), sh), 0.0)
    return jnp.where(known & jnp.isfinite(rgb), rgb, 0.0)


@jax.custom_vjp
def _expansion(harmonics: jax.Array, sh: jax.Array) -> jax.Array:
    """Sum Y_k h_k over k, (N, 3), term by term: XLA then stores neither the basis nor a copy."""
    # It takes a fifth of the time and a twentieth of the memory of `_contraction`, not backwards.
    terms = (harmonics[:, k, None] * _finite(sh[:, k]) for k in range(sh.shape[1]))
    return functools.reduce(jnp.add, terms)


def _contraction(harmonics: jax.Array, sh: jax.Array) -> jax.Array:
    return jnp.einsum("nk,nkc->nc", harmonics, _finite(sh), precision="highest")


def _finite(values: jax.Array) -> jax.Array:
    return jnp.where(jnp.isfinite(values), values, 0.0)


_expansion.defvjp(functools.partial(jax.vjp, _contraction), lambda pullback, given: pullback(given))


def rotate(sh: Array, rotation: Array) -> jax.Array:
    """Rotate coefficients (N, K, 3) by a matrix R (3, 3): the colour along d moves to R d.

    A rotation mixes only harmonics of the same band, so a least-squares fit to the values of the
    basis in sufficiently many directions gives the mixing matrix exactly.
    """
    degree, directions = round(sh.shape[1] ** 0.5) - 1, even_directions(64)
    old = basis(jnp.asarray(directions @ np.asarray(rotation), jnp.float32), degree)
    new = basis(jnp.asarray(directions, jnp.float32), degree)
    mixing = np.linalg.lstsq(np.asarray(new, np.float64), np.asarray(old, np.float64))[0]
    return jnp.asarray(np.einsum("kl,nlc->nkc", mixing, np.asarray(sh, np.float64)), jnp.float32)


def even_directions(count: int) -> np.ndarray:
    """Unit vectors on a golden spiral, shape (count, 3)."""
    places = np.arange(count) + 0.5
    z, angles = 1 - 2 * places / count, np.pi * (1 + np.sqrt(5)) * places
    radii = np.sqrt(1 - z**2)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles), z], axis=1)
