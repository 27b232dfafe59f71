"""Light that stays where it is while the person turns.

What falls from afar on a matt surface of unit normal n is nearly a polynomial of second order in n (Ramamoorthi and Hanrahan,
"An Efficient Representation for Irradiance Environment Maps", 2001). Relative to its mean over all directions, in each channel,

    E(n) = 1 + c . Y(n),   Y(n) = (x, y, z, xy, yz, 3 z^2 - 1, xz, x^2 - y^2).

A texel of albedo a shows a E(n_f) in frame f, and on the mean over the frames T = a E', with E' the mean of E(n_f). So
T E(n_f) / E' is what it shows in any pose.
"""

from __future__ import annotations

import numpy as np
import torch

TERMS = 8
SIZE = 128  # texels along a side of maps of light, at most
DARKEST = 0.1  # of E: a polynomial can fall below what any light does
ROUNDS = 10  # of reweighting
RIDGE = 1e-5  # of a squared colour of 0..1, an observation: what hardly turned tells of no light


def irradiance_basis(normals):
    """Y (...,8) of unit normals (...,3), arrays or tensors; 0 of a normal of length 0."""
    tensors = torch.is_tensor(normals)
    x, y, z = normals.movedim(-1, 0).contiguous() if tensors else np.moveaxis(normals, -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    terms = [x, y, z, x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy]
    return torch.stack(terms).movedim(0, -1) if tensors else np.stack(terms, -1)  # planes are a third of the time


def irradiance(basis, light):
    """E (...,3) of Y (...,8) and coefficients (8,3), at least DARKEST."""
    return (1 + basis @ light).clip(DARKEST)


def fit_light(observed):
    """Coefficients (8,3) that explain best how texels change from frame to frame.

    `observed`: for each layer colours (F,P,3) of P texels in F frames, whether each was seen (F,P), and Y (F,P,8). With T and Y'
    a texel's means, t_f - T = T / E' c . (Y_f - Y'): least squares for c, E' by the last c, reweighted for prints that slip
    and cloth that moved (Cauchy's weights). (Free of E', as t_f E' = T E_f, noise of t_f on both sides would pull E' to 0.)
    """
    known = [_turned(*one) for one in observed]
    light = np.zeros((TERMS, 3))
    for channel in range(3):
        T, change = (np.concatenate([one[k][:, channel] for one in known]) for k in (0, 1))
        mean, away = (np.concatenate([one[k] for one in known]) for k in (2, 3))
        ridge, c = RIDGE * len(T) * np.eye(TERMS), light[:, channel]
        for _ in range(ROUNDS if len(T) else 0):
            A = (T / (1 + mean @ c).clip(DARKEST))[:, None] * away
            left = np.abs(change - A @ c)
            weighted = A / (1 + (left / max(2 * np.median(left), 1e-6)) ** 2)[:, None]
            normal = np.einsum("ni,nj->ij", weighted, A)  # in one order, whatever the threads of a BLAS
            c = np.linalg.solve(normal + ridge, np.einsum("ni,n->i", weighted, change))
        light[:, channel] = c
    return light


def explained(observed):
    """Share of how texels change in every second frame that the light of the other frames explains, of absolute differences from
    the mean; 0 where there is nothing to tell by. `observed` as of `fit_light`."""
    light, before, after = fit_light([tuple(values[::2] for values in one) for one in observed]), 0.0, 0.0
    for colours, seen, basis in observed:
        known, E = seen[::2, :, None], irradiance(basis, light)
        count = np.maximum(known.sum(0), 1)
        T, mean = ((values[::2] * known).sum(0) / count for values in (colours, E))
        both, shown = seen[1::2] & known.any((0, 2)), colours[1::2]
        before += np.abs(shown - T)[both].sum()
        after += np.abs(shown - T * E[1::2] / mean.clip(DARKEST))[both].sum()
    return float(1 - after / before) if before else 0.0


def _turned(colours, seen, basis):
    """Of a layer's N seen texels, frame after frame: T (N,3), t_f - T (N,3), Y' (N,8) and Y_f - Y' (N,8)."""
    count = np.maximum(seen.sum(0), 1)[:, None]
    T, mean = ((values * seen[..., None]).sum(0) / count for values in (colours, basis))
    every = lambda values: np.broadcast_to(values, (len(seen), *values.shape))[seen]
    return every(T), (colours - T)[seen], every(mean), (basis - mean)[seen]
