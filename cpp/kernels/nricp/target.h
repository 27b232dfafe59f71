// What is matched: samples of the template as it stands, and the scan as a target.
#pragma once
#include "geometry/oriented_tree.h"
#include "geometry/topology.h"
#include "kernels/nricp.h"

namespace toile {

/// The template as it stands in a solve.
struct Pose {
    Vertices V, N;  ///< (n,3) places and unit normals
};

/// The vertices that are matched at one level: a cover of the visible template, each standing for the area about it.
struct Samples {
    std::vector<int> vertex;
    std::vector<double> area;
    std::vector<int> stands;  ///< (n,) the sampled vertex that stands for a vertex, -1: a hidden one
    OrientedTree tree;

    Samples(const Vertices& V, const Vertices& N, std::vector<int> vertex, std::vector<double> area,
            std::vector<int> stands);
    void follow(const Pose& pose);
};

struct ScanPoint {
    Vec3 point, normal;
    bool open;  ///< on the scan's border
    double confidence;
};

/// The scan as a target: valid faces, without small closed pieces that float beside it; faces turned inwards are
/// turned about.
class NricpTarget {
public:
    NricpTarget(const Vertices& V, const Faces& F, const Vector& confidence);  ///< (n,) or empty: 1 everywhere

    void orient(const Samples& samples, const Pose& start);  ///< turns all normals when most oppose the template's

    int nearest(const Vec3& x, const Vec3& n, double spread, double reach, int guess) const {
        return tree_.nearest(x, n, spread, reach, guess);
    }
    /// From a vertex along edges down to where `nearest`'s measure is least among neighbours.
    int descend(const Vec3& x, const Vec3& n, double spread, int from) const;
    ScanPoint vertex(int v) const;
    /// The closest point of the faces about a vertex, lifted off its face towards the planes of the corners (Phong
    /// tessellation, Boubekeur and Alexa 2008) by the share `phong`.
    ScanPoint closest(int v, const Vec3& x, double phong) const;

    const Vertices& V() const { return V_; }
    const Vertices& N() const { return N_; }
    const Faces& F() const { return F_; }
    Eigen::Index size() const { return V_.rows(); }
    double noise() const { return noise_; }  ///< estimate of a vertex's standard deviation along its normal

private:
    Vertices V_, N_;
    Faces F_;
    Vector confidence_;
    Adjacency faces_;
    std::vector<char> open_;
    double noise_ = 0;
    OrientedTree tree_;
};

/// Faces of the scan that are valid targets.
Faces target_faces(const NricpFrame& frame, const std::vector<int>& valid);

}  // namespace toile
