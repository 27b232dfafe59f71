// Pose and shape of a body model from a scan, 3D keypoints and the frames before.
//
//   E = N mean_v a_v c_v rho(n_v . (y_v - q_v) / s)^2       surface: y_v on the model, q_v the closest scan point,
//                                                           c_v the scan's confidence there
//     + sum_i rho(|k_i - p_i| / sigma_i)^2                  keypoints
//     + sum_k |log L_k|^2 / joint_sigma_k^2 + limits        pose prior
//     + sum_k (a_k . log L_k)^2 / joint_twist_k^2           turns about the bone a_k, which a straight limb hardly shows
//     + shape_weight |beta|^2 + temporal terms
//
// over local rotations L_k, translation and shape, by Levenberg-Marquardt on dense normal equations; rho is
// Geman-McClure. First keypoints alone (unless started), then surface and keypoints with closest points renewed every
// iteration while the reach shrinks.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "../base/stop.h"
#include "../geometry/body_jacobian.h"
#include "../geometry/topology.h"

namespace toile {

class SurfaceIndex;

namespace skeleton {
class ScanSurface;
}

struct SkeletonOptions {
    double surface_weight = 200;         ///< independent observations that the whole surface counts as
    double surface_sigma = 0.005;        ///< [m]
    double surface_robust = 0.015;       ///< Geman-McClure scale of the last rounds [m]
    double cloth_fit = 0.1;              ///< weight of a clothed vertex whose scan lies outside it, as cloth should
    double reach_start = 0.10;           ///< closest points farther than this do not count, cold [m]
    double reach = 0.04;                 ///< the same in the last rounds, and from a warm start [m]
    double min_cosine = 0.5;             ///< between model and scan normals
    int surface_samples = 5000;          ///< model vertices that look for the scan
    double keypoint_robust_sigmas = 4;   ///< Geman-McClure scale of keypoints, in multiples of their sigma
    double pose_weight = 1;              ///< scales the prior on joint angles
    double shape_weight = 1;             ///< scales |beta|^2
    double limit_sigma = 0.05;           ///< softness of the joints' limits [rad]
    Vector joint_twist;                  ///< (K,) spread of a joint's turn about its bone [rad]; empty, infinity: free
    double temporal_sigma = 0.15;        ///< departure of a joint from its prediction by earlier frames [rad]
    double temporal_translation = 0.05;  ///< the same for the translation [m]
    bool solve_shape = true;             ///< false: the shape of the start is kept (zero without one)
    int max_iterations = 40;             ///< Levenberg-Marquardt steps in the surface stage
    double tolerance = 2e-4;             ///< stop when a step moves the vertices by less, root mean square [m]
    double relative_decrease = 5e-4;     ///< a step that lowers the least energy by less of it is idle
    int idle = 3;                        ///< stop after so many idle steps in a row: matches come and go
};

struct SkeletonPose {
    Vertices rotations;               ///< (K,3) rotation vectors about world axes, relative to the parent [rad]
    Vec3 translation = Vec3::Zero();  ///< [m]
    Vector shape;                     ///< (s,), s <= S; empty: zero
};

/// Observed keypoints, as indices into the model's table.
struct SkeletonKeypoints {
    Indices index;
    Vertices points;  ///< [m]
    Vector sigma;     ///< [m], under a millimetre it counts as one
};

struct SkeletonFrame {
    Vertices scan_V;  ///< may be empty: keypoints alone
    Faces scan_F;
    SkeletonKeypoints keypoints;         ///< may be empty: the surface alone, from a close start
    std::vector<SkeletonPose> start;     ///< none, or one
    std::vector<SkeletonPose> previous;  ///< frames before, newest first: none, one (held) or two (extrapolated)
    Vector clothed;                      ///< (n,) in [0,1], or empty: vertices under cloth
    Vector scan_confidence;  ///< per scan vertex >= 0, or empty: 1 everywhere. Faces with a corner at 0 are not there
    std::shared_ptr<const SurfaceIndex>
        scan_index;  ///< of scan_V and scan_F, where the caller has one: saves making it
};

struct SkeletonResult {
    SkeletonPose pose;
    Vertices V;                        ///< (n,3) posed model [m]
    Vertices joints;                   ///< (K,3) [m]
    Stop stop = Stop::max_iterations;  ///< converged, max_iterations, or unmatched: a scan, none of it in reach
    int iterations = 0;
    std::vector<double> energy;  ///< per iteration of the last stage
    double rms = 0;              ///< of matched point-to-plane distances [m]
    std::int64_t matched = 0;    ///< samples that found the scan
    double keypoint_rms = 0;     ///< [m], outliers included
};

/// Keeps the model, the vertices that look for the scan and their shares of area. Nothing is factorised across steps: the
/// normal equations are dense, of some hundred unknowns, and change with every step; a scan's tree of boxes, where it comes
/// without one, and normals are made once a solve, and for all rounds of `solve_shared`. Nothing is written while it solves.
class SkeletonSolver {
public:
    /// joint_sigma (K,) [rad]: spread of each joint about rest; 0 locks it at its start, infinity frees it.
    /// joint_limit (K,) [rad]: largest angle from rest. vertex_weights (n,): 0 where no scan ever sees the model.
    SkeletonSolver(BodyModel model, Vector joint_sigma, Vector joint_limit, Vector vertex_weights,
                   SkeletonOptions options = {});

    SkeletonResult solve(const SkeletonFrame& frame) const;

    /// One shape for all frames: the poses are eliminated from every frame's normal equations (Schur complement), their
    /// sum gives the step of the shape, and the poses follow; `rounds` times.
    std::vector<SkeletonResult> solve_shared(const std::vector<SkeletonFrame>& frames, int rounds = 4) const;

private:
    SkeletonResult solve_on(const skeleton::ScanSurface* scan, const SkeletonFrame& frame) const;

    BodyModel model_;
    Vector joint_sigma_, joint_limit_, vertex_weights_;
    Vertices twist_;  // (K,3) a_k / joint_twist_k, a_k the bone's direction at rest; 0: free
    SkeletonOptions options_;
    Indices samples_;
    Vector area_;         // (n,) shares of the samples, which sum to 1
    Adjacency faces_of_;  // of each vertex
};

}  // namespace toile
