"""The losses of docs/method/avatars.md, one function each: a mean over what is valid, 0 (with zero gradient) where nothing is, in float32.

Lengths are counted in centimetres, so that 1 mm of error weighs 0.01; colours in 0..1. Over V = vertices, T = textures,
I = image, M = foreground mask; p = predicted, r = registered, t = target, R = rendered, C = captured.
"""

from __future__ import annotations

import torch
from torch.autograd import Function
from torch.autograd.function import once_differentiable

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


class MeanSquare(Function):
    """sum w e^2 / sum w over all elements, w broadcast; what w masks may be anything. On the way back 2 w e / sum w in one
    pass over the elements, where autograd takes several."""

    @staticmethod
    def forward(ctx, error, weight):
        weight = weight.float()
        error = error.float().masked_fill(weight <= 0, 0.0)
        weighted = error * weight
        total = (weight.sum() * (error.numel() // max(weight.numel(), 1))).clamp(min=1e-6)
        ctx.save_for_backward(weighted, total)
        return (weighted * error).sum() / total

    @staticmethod
    @once_differentiable
    def backward(ctx, g):
        weighted, total = ctx.saved_tensors
        return weighted * (2 * g / total), None


def squared_lengths(vectors, weight=None):
    """|v|^2 of vectors (B,n,3) in metres, mean over them, or weighted (B,n) [cm^2]."""
    return 3 * CM**2 * MeanSquare.apply(vectors, vectors.new_ones(1, 1, 1) if weight is None else weight[..., None])


def geometry(predicted, registered, weight=None):
    """|V^p - V^r|^2, mean over the vertices (B,n,3), or weighted (B,n) by their confidence [cm^2]."""
    return squared_lengths(predicted - registered, weight)


def laplacian(operator, predicted, registered, weight=None):
    """|L(V^p) - L(V^r)|^2, mean over the vertices (B,n,3), or weighted (B,n) [cm^2]; L is linear, so L(V^p - V^r)."""
    return squared_lengths(operator(predicted - registered), weight)


def texture(predicted, target, weight):
    """|(T^p - T^t) M|^2 per channel, mean over texels (B,3,T,T) weighted (B,1,T,T) by how well they were seen."""
    return MeanSquare.apply(predicted - target, weight)


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
    return squared_lengths(anchors(predicted - registered))


def total(losses, weights):
    """sum of weight x loss by name; `weights` is a mapping or an object with these attributes; a name it lacks is a
    KeyError."""
    table = weights if isinstance(weights, dict) else dict(weights)
    if not losses:
        raise ValueError("total: no loss given")
    if missing := sorted(set(losses) - set(table)):
        raise KeyError(f"total: no weight for {', '.join(missing)}")
    return sum(table[name] * value for name, value in losses.items())
