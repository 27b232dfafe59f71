// One level of the coarse solve: rigid nodes carry the template (embedded deformation, Sumner et al. 2007).
#pragma once
#include "kernels/nricp/match.h"
#include "kernels/nricp/nodes.h"

namespace toile {

/// x_v = sum_k w_vk (R_k (v - g_k) + c_k). Unknowns of a Gauss-Newton step: (omega_k, delta_k) per node, six in a row;
/// the pattern, its ordering and the sums' order are fixed by the template.
class NricpGraph {
public:
    /// Pulls on the vertices `matched` are summed by prepared lists, those on other vertices one by one.
    NricpGraph(const GeodesicGraph& surface, double radius, const std::vector<int>& matched);

    /// Rotations and centres that carry `rest` nearest to `x` (Procrustes); its normals turn with the nodes.
    void start(const Pose& rest, const Vertices& x);
    void place(const std::vector<int>& vertices, Pose& pose) const;  ///< the rows of these vertices only
    Pose pose() const;
    /// One step on pull + stiffness * rigidity; rotations' differences count `rotation_weight`.
    void step(const Pull& pull, const Vertices& x, double stiffness, double rotation_weight);

    NodeSystem system;

private:
    using Mat6 = Eigen::Matrix<double, 6, 6>;
    Vec3 arm(int node, Eigen::Index v) const {
        return R_[node] * (rest_.V.row(v) - rest_.V.row(system.nodes.vertex[node])).transpose();
    }
    Mat6 about(int node) const;
    void add_pull(const Pull& pull, const Vertices& x, Matrix& gradient);
    void add_rigidity(double stiffness, double rotation_weight, Matrix& gradient);

    Pose rest_;
    Vertices centre_;
    std::vector<Mat3> R_;
};

}  // namespace toile
