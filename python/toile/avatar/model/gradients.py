"""Operations of the networks whose gradients are written out, which costs a CPU less than what autograd makes of them."""

from __future__ import annotations

import torch
from torch.autograd import Function
from torch.autograd.function import once_differentiable


class Mixed(Function):
    """Planes (B,O,P) of maps (B,C,P), channels last, by a matrix (O,C), whose gradient is channels last again: left to
    autograd it would be planes, and the LeakyReLU before it takes several times as long on two layouts."""

    @staticmethod
    def forward(ctx, x, w):
        ctx.save_for_backward(x, w)
        return torch.bmm(w.expand(len(x), *w.shape), x)

    @staticmethod
    @once_differentiable
    def backward(ctx, g):
        x, w = ctx.saved_tensors
        g, w = g.to(x.dtype), w.to(x.dtype)
        return torch.bmm(g.mT, w.expand(len(x), *w.shape)).mT, torch.bmm(g, x.mT).sum(0)


class Normed(Function):
    """w = g v / |v| of v (4 axes) and g along the axis `kept`; on the way back, in fewer operations than autograd's,
    dg = u, dv = g / |v| (dw - u v / |v|), where u = dw . v / |v|."""

    @staticmethod
    def forward(ctx, v, gain, kept):
        others = [d for d in range(4) if d != kept]
        length = torch.linalg.vector_norm(v, dim=others, keepdim=True).clamp_(min=1e-12)
        scale = gain.view([-1 if d == kept else 1 for d in range(4)]) / length
        ctx.save_for_backward(v, length, scale)
        ctx.others = others
        return v * scale

    @staticmethod
    @once_differentiable
    def backward(ctx, g):
        v, length, scale = ctx.saved_tensors
        u = (g * v).sum(ctx.others, keepdim=True) / length
        return torch.addcmul(g * scale, v, u * scale / length, value=-1), u.flatten(), None


class Enlarged(Function):
    """Bilinear maps (B,C,h,w) -> (B,C,kh,kw), along one axis after the other: on a CPU a third of the time of torch's loops.

    Of the k texels in the place of texel i, one lies d = (j + 1/2) / k - 1/2 from its centre: (1 - |d|) x_i + |d| x_n, where n is
    the next one on that side; beyond the ends x is constant.
    """

    @staticmethod
    def forward(ctx, maps, k):
        ctx.k = k
        return enlarged(enlarged(maps, 2, k), 3, k)

    @staticmethod
    @once_differentiable
    def backward(ctx, g):
        return gathered(gathered(g, 3, ctx.k), 2, ctx.k), None


def enlarged(x, dim, k):
    """`Enlarged` along an axis."""
    size = list(x.shape)
    size[dim] *= k
    y = x.new_empty(size)
    for part, (d, inner, beside, end) in phases(y, dim, k):
        torch.lerp(x.narrow(dim, *inner), x.narrow(dim, *beside), d, out=part.narrow(dim, *inner))
        part.select(dim, end).copy_(x.select(dim, end))
    return y


def gathered(g, dim, k):
    """The transpose of `enlarged`."""
    x = 0
    for part, (d, inner, beside, end) in phases(g, dim, k):
        x = x + part * (1 - d)
        x.narrow(dim, *beside).add_(part.narrow(dim, *inner), alpha=d)
        x.select(dim, end).add_(part.select(dim, end), alpha=d)
    return x


def phases(y, dim, k):
    """Each k-th texel along an axis, with |d| of them, the (first, number) of those that have a neighbour there, of their neighbours,
    and the end that has none."""
    n = y.shape[dim] // k
    low, high = (0, n - 1), (1, n - 1)
    for j, part in enumerate(y.unflatten(dim, (n, k)).unbind(dim + 1)):
        d = (j + 0.5) / k - 0.5
        yield part, (-d, high, low, 0) if d < 0 else (d, low, high, n - 1)
