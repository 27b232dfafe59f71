// What pulls the template's vertices: matches of both directions, loops and landmarks as one quadratic per vertex.
#pragma once
#include "kernels/nricp/borders.h"

namespace toile {

/// sum_v (d_v' A_v d_v - 2 b_v . d_v) over displacements d from the current positions. Terms on weighted means of
/// vertices are majorised by Jensen's inequality, |sum_i w_i d_i - r|^2 <= sum_i w_i |d_i - r|^2, tight at the solution.
struct Pull {
    std::vector<Mat3> A;
    Vertices b;
    Vector matched;           ///< (n,) robust weight of the scan match
    std::vector<int> marked;  ///< vertices that borders, loops or landmarks pull, ascending
    double energy = 0, rms = 0, overlap = 0;

    void add(Eigen::Index v, const Mat3& weight, const Vec3& residual) {
        A[v] += weight;
        b.row(v) += (weight * residual).transpose();
    }
};

/// Robust weight of a squared distance.
inline double geman_mcclure(double squared, double mu) {
    const double w = mu * mu / (mu * mu + squared);
    return w * w;
}

struct MatchSettings {
    double mu;       ///< Geman-McClure scale; pairs farther apart than 3 mu do not match
    double spread;   ///< what opposite normals are worth
    double reverse;  ///< weight of the scan -> template term
    bool local;      ///< look about the last match only: the template has hardly moved since
    bool surface;    ///< match to the closest surface point, false: to the closest scan vertex
    double phong, point_weight, boundary_weight, border_weight;
};

/// Matches of one frame; remembers each vertex's last match as the next search's guess.
class Matcher {
public:
    Matcher(const NricpFrame& frame, const NricpTarget& target, const TemplateBorders& of_template, Eigen::Index n);

    Pull pull(const Pose& pose, Samples& samples, const MatchSettings& settings);
    const std::vector<int>& marked() const { return marked_; }

private:
    void to_scan(const Pose& pose, const Samples& samples, const MatchSettings& s, Pull& pull);
    void from_scan(const Pose& pose, Samples& samples, const MatchSettings& s, Pull& pull);

    const NricpFrame& frame_;
    const NricpTarget& target_;
    BorderTarget borders_;
    std::vector<char> in_loop_;  ///< a given loop holds this vertex
    std::vector<int> guess_, marked_;
    std::vector<int> reverse_guess_;  ///< places in the samples last used
    const Samples* reverse_samples_ = nullptr;
};

}  // namespace toile
