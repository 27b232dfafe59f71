// Operators of a triangle mesh from its edge lengths alone, and the mollification that makes every triangle sound.
#pragma once
#include "base/types.h"

namespace toile {

/// Edge lengths (m,3) [m]; entry c lies opposite corner c.
Vertices edge_lengths(const Vertices& V, const Faces& F);

/// Adds to all edges the least amount after which every triangle inequality holds with `margin` [m] to spare
/// (Sharp and Crane 2020, "A Laplacian for Nonmanifold Triangle Meshes", section 4.5); returns that amount [m].
double mollify(Vertices& lengths, double margin);

/// As cotangent_laplacian and voronoi_mass, of lengths that obey the triangle inequality strictly.
Sparse intrinsic_laplacian(const Vertices& lengths, const Faces& F, Eigen::Index n);
Vector intrinsic_voronoi_mass(const Vertices& lengths, const Faces& F, Eigen::Index n);

}  // namespace toile
