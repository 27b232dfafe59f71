// Discrete operators and normals of a triangle mesh.
#pragma once
#include "../base/types.h"

namespace toile {

/// Cotangent Laplacian (n,n): negative semi-definite, rows sum to zero, off-diagonal +(cot a + cot b) / 2.
Sparse cotangent_laplacian(const Vertices& V, const Faces& F);

/// Lumped mass per vertex [m^2], mixed Voronoi areas (Meyer et al. 2003); the sum is the area of the mesh.
Vector voronoi_mass(const Vertices& V, const Faces& F);

Vertices face_normals(const Vertices& V, const Faces& F);    ///< (m,3), unit, or zero for a face of no area
Vector face_areas(const Vertices& V, const Faces& F);        ///< (m,) [m^2]
Vertices vertex_normals(const Vertices& V, const Faces& F);  ///< (n,3), area-weighted, unit, or zero

}  // namespace toile
