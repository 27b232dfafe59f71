// The sparse normal equations of a deformation graph: one dense block a pair of nodes that share vertices.
#pragma once
#include "base/sparse.h"
#include "geometry/nodes.h"

namespace toile {

/// Of one vertex in a node or in a pair of nodes.
struct Share {
    int at;
    float weight;
};

/// Rows of shares, each ascending.
struct Shares {
    std::vector<std::size_t> start;
    std::vector<Share> of;
};

/// Nodes of a template, which vertices each pair shares, and the matrix H over `size` unknowns a node; pattern, ordering
/// and the order of sums are fixed by the template.
class NodeSystem {
public:
    NodeSystem(const GeodesicGraph& surface, double radius, const std::vector<int>& matched, int size);

    using Block = Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>>;
    Block block(std::size_t pair);  ///< of H, at (l, k) of the pair (k, l), k <= l: the lower triangle
    Block own(int node) { return block(pair_start_[node]); }
    std::size_t pair(int k, int l) const;  ///< index of (k, l), k <= l

    /// Rotation about a node's place, and where that place goes, that carry the node's vertices best from `rest` to `x`.
    std::pair<Mat3, Vec3> rigid_fit(int node, const Vertices& rest, const Vertices& x) const;

    void solve_into(Matrix& gradient);  ///< H^-1 gradient, after a touch of damping

    DeformationNodes nodes;
    double radius;
    std::vector<int> matched;  ///< vertices whose pulls are summed by `shared`
    std::vector<char> is_matched;
    Shares carried;  ///< per node: vertices with their weights
    Shares shared;   ///< per pair: places in `matched` with the product of both weights
    CholeskyFactor factor;

private:
    int size_;
    std::vector<std::size_t> pair_start_;  ///< per node into `nodes.pairs`
    Sparse H_;
};

}  // namespace toile
