"""METHOD's losses, one function each: a mean over what is valid, 0 (with zero gradient) where nothing is, in float32.

Lengths are counted in centimetres, so that 1 mm of error weighs 0.01; colours in 0..1. Over V = vertices, T = textures,
I = image, M = foreground mask; p = predicted, r = registered, t = target, R = rendered, C = captured.
"""

from __future__ import annotations

import warnings

import numpy as np
import torch
from torch import nn

CM = 100.0  # per metre


def valid(error, weight=None):
    """`error` where `weight` (broadcast) is above 0, else 0, so that what is masked may be anything, NaN included."""
    error = error.float()
    return error if weight is None else torch.where(weight > 0, error, 0.0)


def weighted_mean(values, weight=None):
    """sum w x / sum w over all elements; `weight` broadcasts against `values`."""
    if weight is None:
        return values.sum() / max(values.numel(), 1)
    weight = weight.float().expand_as(values)
    return (values * weight).sum() / weight.sum().clamp(min=1e-6)


def squared_lengths(vectors):
    """|v|^2 (..., n) of vectors (..., n, 3) in metres [cm^2]."""
    return (vectors * CM).square().sum(-1)


def geometry(predicted, registered, weight=None):
    """|V^p - V^r|^2, mean over the vertices (B,n,3), or weighted (B,n) by their confidence [cm^2]."""
    error = valid(predicted - registered, None if weight is None else weight[..., None])
    return weighted_mean(squared_lengths(error), weight)


def laplacian(operator, predicted, registered, weight=None):
    """|L(V^p) - L(V^r)|^2, mean over the vertices (B,n,3), or weighted (B,n) [cm^2]; L is linear, so L(V^p - V^r)."""
    return weighted_mean(squared_lengths(operator(predicted - registered)), weight)


def texture(predicted, target, weight):
    """|(T^p - T^t) M|^2 per channel, mean over texels (B,3,T,T) weighted (B,1,T,T) by how well they were seen."""
    return weighted_mean(valid(predicted - target, weight).square(), weight)


def kl(mean, logvar):
    """KL(N(mean, exp logvar) | N(0, 1)) = sum 1/2 (mean^2 + exp(logvar) - 1 - logvar), mean over the batch [nat]."""
    mean, logvar = mean.float(), logvar.float()
    return 0.5 * (mean.square() + logvar.exp() - 1 - logvar).sum(-1).mean()


def image_l1(rendered, captured, mask):
    """|I^R - I^C| per channel, mean over the captured foreground: images (B,3,H,W), mask (B,H,W)."""
    return weighted_mean(valid(rendered - captured, mask[:, None]).abs(), mask[:, None])


def mask_l1(rendered, captured):
    """|M^R - M^C|, mean over all pixels (B,H,W)."""
    return weighted_mean(valid(rendered - captured).abs())


def soft_visibility(depth, labels, layer_labels, c):
    """E_soft = S^2 where S = sigmoid((D^C - D^B) / c) > 1/2 and the pixel is labelled clothing, else 0.

    depth (L,H,W) [m] of each layer by itself, inf where it is not; labels (H,W) ids; layer_labels (L,), -1 for a layer
    that is no garment; c [m]. D^B is the nearest of the other layers; the mean is over the labelled pixels that both
    cover. It pulls where a z-buffer has no gradient: the wrong layer is in front.
    """
    terms, covered = [], []
    for i, label in enumerate(layer_labels):
        others = [j for j in range(len(layer_labels)) if j != i]
        if label < 0 or not others:
            continue
        cloth, other = depth[i].float(), depth[others].float().amin(0)
        both = torch.isfinite(cloth) & torch.isfinite(other) & (labels == label)
        s = torch.sigmoid(torch.where(both, cloth - other, 0.0) / c)
        terms.append(torch.where(both & (s > 0.5), s.square(), 0.0).sum())
        covered.append(both.sum())
    if not terms:
        return torch.zeros((), device=depth.device)
    return torch.stack(terms).sum() / torch.stack(covered).sum().clamp(min=1)


def impute(anchors, predicted, registered):
    """The baseline's disentanglement: what the pose determines must not change with the code.

    `predicted` was decoded from the code of another sample or of the prior, with this sample's pose and face. What the
    driving signal sees of it, a centroid per joint, A V with A (K,n), has to agree: |A(V^p) - A(V^r)|^2, mean over the
    joints [cm^2] (after Bagautdinov et al. 2021, where a decoded body must give back its driving signal).
    """
    return weighted_mean(squared_lengths(anchors(predicted - registered)))


def total(losses, weights):
    """sum of weight x loss by name; `weights` is a mapping or an object with these attributes; a name it lacks is a
    KeyError."""
    table = weights if isinstance(weights, dict) else dict(weights)
    if not losses:
        raise ValueError("total: no loss given")
    if missing := sorted(set(losses) - set(table)):
        raise KeyError(f"total: no weight for {', '.join(missing)}")
    return sum(table[name] * value for name, value in losses.items())


class Linear(nn.Module):
    """A fixed sparse matrix (m,n) applied to every sample's (n,3); not part of the saved state.

    Kept as plain arrays, which can be copied and sent, and multiplied as CSR: a tenth of the time that COO takes.
    """

    def __init__(self, matrix):
        super().__init__()
        self.shape = matrix.shape
        for name, m in (("matrix", matrix.tocsr()), ("transposed", matrix.T.tocsr())):
            m.sort_indices()
            for part, dtype in (("indptr", np.int64), ("indices", np.int64), ("data", np.float32)):
                values = torch.from_numpy(getattr(m, part).astype(dtype))
                self.register_buffer(f"{name}_{part}", values, persistent=False)

    def sparse(self, name, shape):
        """The CSR tensor of this name."""
        parts = [getattr(self, f"{name}_{part}") for part in ("indptr", "indices", "data")]
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
            return torch.sparse_csr_tensor(*parts, size=shape, check_invariants=False)

    def forward(self, x):
        m, n = self.shape
        with torch.autocast(x.device.type, enabled=False):
            columns = x.float().permute(1, 0, 2).reshape(n, -1)
            y = Product.apply(self.sparse("matrix", (m, n)), self.sparse("transposed", (n, m)), columns)
        return y.reshape(m, len(x), -1).permute(1, 0, 2)


class Product(torch.autograd.Function):
    """A x of a constant sparse A, whose transpose is at hand for the gradient."""

    @staticmethod
    def forward(ctx, matrix, transposed, x):
        ctx.transposed = transposed
        return matrix @ x

    @staticmethod
    def backward(ctx, gradient):
        return None, None, ctx.transposed @ gradient.contiguous()


def uniform_laplacian(faces, n):
    """L v = v - mean of its neighbours, as `Linear` (n,n): 0 for a vertex without neighbours, and for translations."""
    from scipy.sparse import coo_matrix, diags

    f = np.asarray(faces, dtype=np.int64)
    i = np.concatenate([f[:, [0, 1, 2]].ravel(), f[:, [1, 2, 0]].ravel()])
    j = np.concatenate([f[:, [1, 2, 0]].ravel(), f[:, [0, 1, 2]].ravel()])
    adjacent = coo_matrix((np.ones(len(i)), (i, j)), shape=(n, n)).tocsr()
    adjacent.data[:] = 1.0
    degree = np.asarray(adjacent.sum(1)).ravel()
    return Linear((diags((degree > 0).astype(float)) - diags(1 / np.maximum(degree, 1)) @ adjacent).tocsr())


def joint_centroids(skin_idx, skin_val, joints):
    """A (K,n) as `Linear`: the mean of the vertices by their skinning weights; 0 for a joint that moves no vertex."""
    from scipy.sparse import coo_matrix, diags

    n, width = skin_idx.shape
    rows, columns = np.asarray(skin_idx).ravel(), np.repeat(np.arange(n), width)
    weights = coo_matrix((np.asarray(skin_val, dtype=np.float64).ravel(), (rows, columns)), shape=(joints, n)).tocsr()
    sums = np.asarray(weights.sum(1)).ravel()
    return Linear((diags(np.where(sums > 1e-9, 1 / np.maximum(sums, 1e-9), 0)) @ weights).tocsr())
