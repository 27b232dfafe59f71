"""Linear blend skinning in torch."""

from __future__ import annotations

import numpy as np
import torch
from scipy.sparse import coo_matrix
from torch import nn

from .operators import Linear


class Skeleton(nn.Module):
    """Forward kinematics about world axes: R_k = R_parent exp(r_k), x_k = x_parent + R_parent (J_k - J_parent).

    All joints at once: each takes in as many joints above it as it knows already, so d of them in log2 d products (pointer jumping).
    """

    def __init__(self, J, parents):
        super().__init__()
        J, parents = np.asarray(J, dtype=np.float32), np.asarray(parents)
        above = np.append(np.where(parents < 0, len(J), parents), len(J))  # the last stands for what lies above a root
        offset = J - np.append(J, np.zeros((1, 3), np.float32), axis=0)[above[:-1]]
        self.register_buffer("J", torch.as_tensor(J), persistent=False)
        self.register_buffer("offset", torch.as_tensor(offset), persistent=False)
        self.register_buffer("root", torch.as_tensor(parents < 0)[:, None].float(), persistent=False)
        self.register_buffer("still", torch.eye(4), persistent=False)
        self.parents, self.jumps = parents.tolist(), 0
        while (above < len(J)).any():
            self.register_buffer(f"above{self.jumps}", torch.as_tensor(above), persistent=False)
            above, self.jumps = above[above], self.jumps + 1

    def forward(self, rotations, translation):
        """Rotation vectors (B,K,3), translation (B,3) -> skinning transforms R (B,K,3,3), t (B,K,3): x = sum_k w_k (R_k v + t_k)."""
        offset = self.offset + self.root * translation[:, None]
        M = torch.cat([rotation_matrices(rotations), offset[..., None]], -1)  # (B,K,3,4), in the parent's frame
        M = torch.cat([M, self.still[3].expand(*M.shape[:2], 1, 4)], -2)
        M = torch.cat([M, self.still.expand(len(M), 1, 4, 4)], 1)
        for i in range(self.jumps):
            M = M.index_select(1, getattr(self, f"above{i}")) @ M
        R, x = M[:, :-1, :3, :3], M[:, :-1, :3, 3]
        return R, x - (R @ self.J[..., None])[..., 0]


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
