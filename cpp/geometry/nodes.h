// Nodes of an embedded deformation: a geodesic cover of a mesh and the smooth weights with which nodes carry vertices.
#pragma once
#include <vector>

#include "base/types.h"

namespace toile {

/// Geodesic distances along edges, and along links from every vertex of a smaller component to the nearest vertex of the
/// largest one, so that eyes and tongue follow the face.
class GeodesicGraph {
public:
    GeodesicGraph(const Vertices& V, const Faces& F);

    /// Dijkstra from one vertex up to `reach`, in order of (distance, vertex). `distance` is (n,) scratch, infinite
    /// before and after.
    template <class Visit>
    void walk(int source, double reach, std::vector<double>& distance, Visit&& visit) const;

    int size() const { return static_cast<int>(start_.size()) - 1; }
    double median_length() const;  ///< of edges and links, 0 without any

private:
    std::vector<int> start_, to_;
    std::vector<double> length_;
};

/// Vertices such that no vertex is farther than `radius` [m] from one of them: the first uncovered one, again and again.
struct Cover {
    std::vector<int> vertex;
    std::vector<int> owner;  ///< (n,) the nearest of `vertex`, as an index into it
};
Cover cover(const GeodesicGraph& graph, double radius);

struct DeformationNodes {
    static constexpr int carriers = 6;  ///< most nodes a vertex

    std::vector<int> vertex;                 ///< mesh vertex of each node
    std::vector<int> start;                  ///< (n+1) the nodes of vertex v are carrier[start[v] .. start[v + 1])
    std::vector<int> carrier;                ///< ascending within a vertex
    std::vector<double> weight;              ///< beside `carrier`, sums to 1 per vertex
    std::vector<std::pair<int, int>> pairs;  ///< (k, l), k <= l: nodes that share a vertex or are neighbours; sorted

    int size() const { return static_cast<int>(vertex.size()); }
};

/// Nodes at a cover's vertices. A node's weight dies at 2 radius as (1 - d^2 / 4 r^2)^3 (Li, Sumner, Pauly 2008).
DeformationNodes deformation_nodes(const GeodesicGraph& graph, double radius);

}  // namespace toile
