// Nodes of an embedded deformation: a geodesic cover of a mesh and the smooth weights with which nodes carry vertices.
#pragma once
#include <vector>

#include "base/types.h"

namespace toile {

/// Geodesic distances run along edges, and along links from every vertex of a smaller component to the nearest vertex
/// of the largest one, so that eyes and tongue follow the face.
struct DeformationNodes {
    static constexpr int carriers = 6;  ///< most nodes a vertex

    std::vector<int> vertex;         ///< mesh vertex of each node
    std::vector<int> start;          ///< (n+1) the nodes of vertex v are carrier[start[v] .. start[v + 1])
    std::vector<int> carrier;        ///< ascending within a vertex
    std::vector<double> weight;      ///< beside `carrier`, sums to 1 per vertex
    std::vector<std::pair<int, int>> pairs;  ///< (k, l), k <= l: nodes that share a vertex or are neighbours; sorted

    int size() const { return static_cast<int>(vertex.size()); }
};

/// Cover by farthest-first in vertex order: no vertex is farther than `radius` [m] from a node. A node's weight dies at
/// 2 radius as (1 - d^2 / 4 r^2)^3 (Li, Sumner, Pauly 2008).
DeformationNodes cover_by_nodes(const Vertices& V, const Faces& F, double radius);

}  // namespace toile
