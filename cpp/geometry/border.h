// The border curves of a mesh, with the directions in which they face.
#pragma once
#include <array>
#include <vector>

#include "base/types.h"

namespace toile {

/// A connected set of edges that have one face only. Conormals lie in the surface, across the border, and point off it.
struct Border {
    std::vector<int> vertex;                 ///< ascending, those where two of its edges meet
    std::vector<std::array<int, 2>> beside;  ///< the other ends of both, so that (x_1 - x_0) x normal points off
    std::vector<double> length;              ///< half of both edges [m]
    Vertices conormal;                       ///< (vertices,3) unit, mean of both edges'

    double total() const;
    /// Mean conormal: of unit length round a tube's end, zero round a hole in a flat sheet.
    Eigen::RowVector3d facing() const;
};

/// `N` (n,3) unit normals. In the order of the smallest vertices.
std::vector<Border> borders(const Vertices& V, const Vertices& N, const Faces& F);

}  // namespace toile
