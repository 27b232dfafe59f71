// One level of the coarse solve: rigid nodes carry the template (embedded deformation, Sumner et al. 2007).
#pragma once
#include "base/sparse.h"
#include "geometry/nodes.h"
#include "kernels/nricp_match.h"

namespace toile {

/// x_v = sum_k w_vk (R_k (v - g_k) + c_k). Unknowns of a Gauss-Newton step: (omega_k, delta_k) per node, six in a row;
/// the pattern, its ordering and the sums' order are fixed by the template.
class NricpGraph {
public:
    /// Pulls on the vertices `matched` are summed by prepared lists, those on other vertices one by one.
    NricpGraph(const GeodesicGraph& surface, double radius, const std::vector<int>& matched);

    /// Rotations and centres that carry `rest` nearest to `x` (Procrustes); normals are `rest_N` turned with the nodes.
    void start(const Vertices& rest, const Vertices& rest_N, const Vertices& x);
    void place(const std::vector<int>& vertices, Pose& pose) const;  ///< the rows of these vertices only
    Pose pose() const;
    /// One step on pull + stiffness * rigidity; rotations' differences count `rotation_weight`.
    void step(const Pull& pull, const Vertices& x, double stiffness, double rotation_weight);

    CholeskyFactor factor;

private:
    using Mat6 = Eigen::Matrix<double, 6, 6>;
    struct Share {  ///< of one vertex in a node or in a pair of nodes
        int at;
        float weight;
    };
    struct Shares {
        std::vector<std::size_t> start;
        std::vector<Share> of;
    };
    template <class Each>
    static Shares collect(std::size_t rows, Each&& each);

    Vec3 arm(int node, Eigen::Index v) const { return R_[node] * (rest_.row(v) - rest_.row(nodes_.vertex[node])).transpose(); }
    std::size_t pair(int k, int l) const;
    Mat6 about(int node) const;
    void add_pull(const Pull& pull, const Vertices& x, Vector& gradient);
    void add_rigidity(double stiffness, double rotation_weight, Vector& gradient);
    Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>> block(std::size_t pair);

    DeformationNodes nodes_;
    double radius_;
    Vertices rest_, rest_N_, centre_;
    std::vector<Mat3> R_;
    std::vector<int> matched_;
    std::vector<char> is_matched_;
    Shares carried_;                       ///< per node: vertices
    Shares shared_;                        ///< per pair: places in `matched_`
    std::vector<std::size_t> pair_start_;  ///< per node into `nodes_.pairs`
    Sparse H_;
};

}  // namespace toile
