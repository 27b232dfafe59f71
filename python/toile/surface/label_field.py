"""Labels of a surface's vertices as a Markov random field, and the islands that it leaves."""

import numpy as np

from .. import kernels


def solve_labels(cost, mesh, colour, settings):
    """Columns (n,) of `cost` (n,L), of a Potts MRF on a Mesh with vertex colours (n,3) in 0..1: an edge costs its length, less across an
    edge of the picture. `settings` are SegmentSettings."""
    edges, V = mesh.edges, mesh.vertices
    length = np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1)
    difference = np.linalg.norm(colour[edges[:, 0]] - colour[edges[:, 1]], axis=1)
    weights = settings.smoothness * np.clip(length / max(length.mean(), 1e-12), 0, settings.max_edge_ratio)
    weights = weights / (1 + (difference / settings.colour_contrast) ** 2) + settings.smoothness_floor
    return np.asarray(
        kernels.mrf(cost - cost.min(1, keepdims=True), edges, weights, **settings.mrf.model_dump()).labels
    )


def dissolve_islands(labels, mesh, settings, likelihood=None, seen=None):
    """Regions of one label (n,) smaller than `min_region` [m^2] take the label around them, if they touch one. So do those up to
    `doubted_region` whose colours, of log likelihoods (n,L) where they are `seen` (n,), are rather that label's."""
    V, F, edges = mesh.vertices, mesh.faces, mesh.edges
    area = np.bincount(F.ravel(), np.repeat(kernels.face_areas(V, F) / 3, 3), minlength=len(V))
    least = settings.min_region if likelihood is None else max(settings.min_region, settings.doubted_region)
    labels, rows = labels.copy(), np.arange(len(V))
    for _ in range(2):  # what has grown may touch others
        same = labels[edges[:, 0]] == labels[edges[:, 1]]
        region = kernels.vertex_components(edges[same][:, [0, 1, 1]], len(V))
        areas = np.bincount(region, area)
        small = (areas < least)[region]
        votes = _votes_around(labels, region, small, edges[~same])
        if votes is None:
            break
        around = votes.argmax(1)[region]
        change = small & (votes[region].sum(1) > 0)
        if likelihood is not None:
            for_own = np.where(seen, likelihood[rows, labels] - likelihood[rows, around], 0)
            change &= ((areas < settings.min_region) | (np.bincount(region, area * for_own) < 0))[region]
        labels[change] = around[change]
    return labels


def _votes_around(labels, region, small, across):
    """How many of the edges `across` (e,2) join each region to each label (regions,labels) of a region that is not `small`; None
    where none joins a small region to another."""
    across = np.concatenate([across, across[:, ::-1]])
    across = across[small[across[:, 0]] & ~small[across[:, 1]]]
    if len(across) == 0:
        return None
    votes = np.zeros((region.max() + 1, labels.max() + 1))
    np.add.at(votes, (region[across[:, 0]], labels[across[:, 1]]), 1)
    return votes
