// What pulls the template's vertices: matches of both directions, loops and landmarks as one quadratic per vertex.
#pragma once
#include "geometry/closest.h"
#include "kernels/nricp.h"

namespace toile {

/// sum_v (d_v' A_v d_v - 2 b_v . d_v) over displacements d from the current positions. Terms on weighted means of
/// vertices are majorised by Jensen's inequality, |sum_i w_i d_i - r|^2 <= sum_i w_i |d_i - r|^2, tight at the solution.
struct Pull {
    std::vector<Mat3> A;
    Vertices b;
    Vector matched;      ///< (n,) robust weight of the scan match
    double energy = 0, rms = 0, overlap = 0;

    void add(Eigen::Index v, const Mat3& weight, const Vec3& residual) {
        A[v] += weight;
        b.row(v) += (weight * residual).transpose();
    }
};

/// The scan as a target: valid faces, without small closed pieces that float beside it.
class NricpTarget {
public:
    NricpTarget(const Vertices& V, const Faces& F);

    SurfaceIndex index;
    Vertices normals;            ///< per vertex
    std::vector<char> boundary;  ///< per vertex
    double roughness = 0;        ///< mean of 1 - n_i . n_j over edges
    double sign = 1;             ///< -1 for a scan whose faces point inwards

    Vec3 normal_at(const SurfacePoint& hit) const;
    bool on_boundary(const SurfacePoint& hit) const;
    void orient(const Vertices& x, const Vertices& template_normals, const Vector& visible);
};

struct MatchSettings {
    double mu, reverse, point_weight, boundary_weight;
};

/// Faces of the scan that are valid targets.
Faces target_faces(const Vertices& V, const Faces& F, const Indices& labels, const std::vector<int>& valid);

Pull pull_of(const NricpTarget& target, const NricpFrame& frame, const Vertices& x, const Faces& F,
             const Vector& area, const Vector& visible, const MatchSettings& settings);

}  // namespace toile
