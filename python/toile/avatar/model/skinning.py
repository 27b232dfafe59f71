"""Linear blend skinning in torch."""

from __future__ import annotations

import numpy as np
import torch
from scipy.sparse import coo_matrix
from torch import nn

from .operators import Linear


class Skeleton(nn.Module):
    """Forward kinematics about world axes: R_k = R_parent exp(r_k), x_k = x_parent + R_parent (J_k - J_parent)."""

    def __init__(self, J, parents):
        super().__init__()
        self.register_buffer("J", torch.as_tensor(np.asarray(J, dtype=np.float32)), persistent=False)
        self.levels = _levels([int(p) for p in parents])
        place, order = {}, []
        for i, (joints, above) in enumerate(self.levels):
            place |= {joint: row for row, joint in enumerate(joints)}
            order += joints
            self.register_buffer(f"joints{i}", torch.tensor(joints), persistent=False)
            if above is not None:
                self.register_buffer(f"above{i}", torch.tensor([place[p] for p in above]), persistent=False)
                self.register_buffer(f"offset{i}", (self.J[joints] - self.J[above])[..., None], persistent=False)
        self.register_buffer("back", torch.tensor(order).argsort(), persistent=False)

    def forward(self, rotations, translation):
        """Rotation vectors (B,K,3), translation (B,3) -> skinning transforms R (B,K,3,3), t (B,K,3): x = sum_k w_k (R_k v + t_k)."""
        local = rotation_matrices(rotations)
        R, x = [local.index_select(1, self.joints0)], [self.J[self.joints0] + translation[:, None]]
        for i in range(1, len(self.levels)):  # joints as deep as one another at once
            above = R[-1].index_select(1, getattr(self, f"above{i}"))
            x.append(x[-1].index_select(1, getattr(self, f"above{i}")) + (above @ getattr(self, f"offset{i}"))[..., 0])
            R.append(above @ local.index_select(1, getattr(self, f"joints{i}")))
        R, x = (torch.cat(parts, 1).index_select(1, self.back) for parts in (R, x))
        return R, x - (R @ self.J[..., None])[..., 0]


def _levels(parents):
    """[(joints, their parents)] by depth in the tree; the roots' parents are None."""
    depth = []
    for p in parents:
        depth.append(0 if p < 0 else depth[p] + 1)
    levels = [[k for k, d in enumerate(depth) if d == level] for level in range(max(depth) + 1)]
    return [(joints, None if i == 0 else [parents[k] for k in joints]) for i, joints in enumerate(levels)]


def rotation_matrices(r):
    """Rotation vectors (...,3) [rad] -> (...,3,3), smooth at zero (Rodrigues)."""
    squared = r.square().sum(-1)[..., None, None]
    small = squared < 1e-8
    angle = torch.where(small, torch.ones_like(squared), squared).sqrt()
    a = torch.where(small, 1 - squared / 6, angle.sin() / angle)
    b = torch.where(small, 0.5 - squared / 24, (1 - angle.cos()) / angle.square())
    x, y, z = r.unbind(-1)
    o = torch.zeros_like(x)
    S = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(*r.shape[:-1], 3, 3)
    return torch.eye(3, dtype=r.dtype, device=r.device) + a * S + b * (S @ S)


class Skin(nn.Module):
    """Linear blend skinning of one layer, and its inverse per vertex."""

    def __init__(self, layer):
        super().__init__()
        joints = np.asarray(layer.skin_idx, dtype=np.int64)
        rows = np.repeat(np.arange(len(joints)), joints.shape[1])
        self.mix = Linear(coo_matrix((np.ravel(layer.skin_val), (rows, joints.ravel()))))

    def blend(self, R, t):
        """Per vertex A (B,n,3,3) and b (B,n,3): skinning is A v + b."""
        mixed = self.mix(torch.cat([R.flatten(2), t], -1)[:, : self.mix.shape[1]])  # (B,n,12)
        return mixed[..., :9].unflatten(-1, (3, 3)), mixed[..., 9:]

    def pose(self, unposed, R, t):
        """(B,n,3) unposed -> posed, in the world."""
        A, b = self.blend(R, t)
        x, y, z = unposed.unsqueeze(-1).unbind(-2)
        return b + A[..., 0] * x + A[..., 1] * y + A[..., 2] * z

    def unpose(self, posed, R, t):
        """The inverse of `pose`: the rows' cross products over the determinant are the columns of A's inverse."""
        A, b = self.blend(R, t)
        p, (x, y, z) = (posed - b).permute(2, 0, 1), A.permute(2, 3, 0, 1).contiguous()
        yz = _cross(y, z)
        v = (yz * p[0] + _cross(z, x) * p[1] + _cross(x, y) * p[2]) / (x * yz).sum(0)
        return v.permute(1, 2, 0).contiguous()


def _cross(a, b):
    """a x b of two (3,...); here planes of coordinates take half the time of torch's on vectors."""
    return torch.stack([a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))])
