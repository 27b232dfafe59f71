// What pulls the template's vertices: matches of both directions, loops and landmarks as one quadratic per vertex.
#pragma once
#include "geometry/oriented_tree.h"
#include "geometry/topology.h"
#include "kernels/nricp.h"

namespace toile {

/// sum_v (d_v' A_v d_v - 2 b_v . d_v) over displacements d from the current positions. Terms on weighted means of
/// vertices are majorised by Jensen's inequality, |sum_i w_i d_i - r|^2 <= sum_i w_i |d_i - r|^2, tight at the solution.
struct Pull {
    std::vector<Mat3> A;
    Vertices b;
    Vector matched;      ///< (n,) robust weight of the scan match
    std::vector<int> marked;  ///< vertices that loops or landmarks pull, ascending
    double energy = 0, rms = 0, overlap = 0;

    void add(Eigen::Index v, const Mat3& weight, const Vec3& residual) {
        A[v] += weight;
        b.row(v) += (weight * residual).transpose();
    }
};

/// The template as it stands in a solve.
struct Pose {
    Vertices V, N;  ///< (n,3) places and unit normals
};

/// The vertices that are matched at one level: a cover of the visible template, each standing for the area about it.
struct Samples {
    std::vector<int> vertex;
    std::vector<double> area;
    OrientedTree tree;

    Samples(const Vertices& V, const Vertices& N, std::vector<int> vertex, std::vector<double> area);
    void follow(const Pose& pose);
};

struct ScanPoint {
    Vec3 point, normal;
    bool open;  ///< on the scan's border
};

/// The scan as a target: valid faces, without small closed pieces that float beside it; faces turned inwards are
/// turned about.
class NricpTarget {
public:
    NricpTarget(const Vertices& V, const Faces& F);

    void orient(const Samples& samples, const Pose& start);  ///< turns all normals when most oppose the template's

    int nearest(const Vec3& x, const Vec3& n, double spread, double reach, int guess) const {
        return tree_.nearest(x, n, spread, reach, guess);
    }
    ScanPoint vertex(int v) const;
    /// The closest point of the faces about a vertex, lifted off its face towards the planes of the corners (Phong
    /// tessellation, Boubekeur and Alexa 2008) by the share `phong`.
    ScanPoint closest(int v, const Vec3& x, double phong) const;

    Eigen::Index size() const { return V_.rows(); }
    double noise() const { return noise_; }  ///< estimate of a vertex's standard deviation along its normal

private:
    Vertices V_, N_;
    Faces F_;
    Adjacency faces_;
    std::vector<char> open_;
    double noise_ = 0;
    OrientedTree tree_;
};

struct MatchSettings {
    double mu;           ///< Geman-McClure scale; pairs farther apart than 3 mu do not match
    double spread;       ///< what opposite normals are worth
    double reverse;      ///< weight of the scan -> template term
    bool surface;        ///< match to the closest surface point, false: to the closest scan vertex
    double phong, point_weight, boundary_weight;
};

/// Faces of the scan that are valid targets.
Faces target_faces(const Vertices& V, const Faces& F, const Indices& labels, const std::vector<int>& valid);

/// Matches of one frame; remembers each vertex's last match as the next search's guess.
class Matcher {
public:
    Matcher(const NricpFrame& frame, const NricpTarget& target, Eigen::Index n);

    Pull pull(const Pose& pose, Samples& samples, const MatchSettings& settings);
    const std::vector<int>& marked() const { return marked_; }

private:
    void to_scan(const Pose& pose, const Samples& samples, const MatchSettings& s, Pull& pull);
    void from_scan(const Pose& pose, Samples& samples, const MatchSettings& s, Pull& pull);

    const NricpFrame& frame_;
    const NricpTarget& target_;
    std::vector<int> guess_, reverse_guess_, marked_;
};

}  // namespace toile
