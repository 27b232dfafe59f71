// One level of the coarse solve: rigid nodes carry the template (embedded deformation, Sumner et al. 2007).
#pragma once
#include "base/sparse.h"
#include "geometry/nodes.h"
#include "kernels/nricp_match.h"

namespace toile {

/// x_v = sum_k w_vk (R_k (v - g_k) + c_k) + o_v. Unknowns of a Gauss-Newton step: (omega_k, delta_k) per node, six in a
/// row; the pattern, its ordering and the sums' order are fixed by the template.
class NricpGraph {
public:
    NricpGraph(const Vertices& rest, const Faces& F, double radius);

    void start(const Vertices& rest, const Vertices& x);  ///< rotations and centres by Procrustes, o the remainder
    Vertices positions() const;
    /// One step on pull + stiffness * rigidity; rotations' differences count `rotation_weight`.
    void step(const Pull& pull, double stiffness, double rotation_weight);

    CholeskyFactor factor;

private:
    struct Share {  ///< one vertex's part in one pair of nodes
        int vertex;
        double weight;
    };
    Vec3 arm(int node, Eigen::Index v) const { return R_[node] * (rest_.row(v) - rest_.row(nodes_.vertex[node])).transpose(); }
    void add_rigidity(double stiffness, double rotation_weight, Vector& gradient);
    Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>> block(std::size_t pair);
    void add_pair(int k, int l, const Eigen::Matrix<double, 6, 6>& value);

    DeformationNodes nodes_;
    double radius_;
    Vertices rest_, offset_, centre_;
    std::vector<Mat3> R_;
    std::vector<std::size_t> share_start_;  ///< per pair into `shares_`
    std::vector<Share> shares_;
    std::vector<std::size_t> pair_start_;   ///< per node into `nodes_.pairs`
    Sparse H_;
};

}  // namespace toile
