"""Triangles of equal size in place of others, by a library: no kernel of toile touches the truth."""

import numpy as np


def remesh(V, F, edge, iterations=8, crease=60.0):
    """Vertices (n,3) and faces (m,3) of a surface remeshed isotropically to edges of about `edge` [m] (pymeshlab); open
    borders stay open, and edges that bend by more than `crease` [degrees] stay edges."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(V, F))
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=iterations, targetlen=pymeshlab.PureValue(edge), featuredeg=crease
    )
    meshes.meshing_remove_unreferenced_vertices()
    out = meshes.current_mesh()
    return np.asarray(out.vertex_matrix()).copy(), np.asarray(out.face_matrix()).astype(np.int32)
