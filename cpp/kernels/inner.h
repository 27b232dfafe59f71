// The body under the garments: a fused rest shape from all frames, then the body of each frame.
//
// Both solve for displacements d (n,3) with one scalar matrix for the three coordinates,
//
//   E(d) = length^4 |L d|^2_{M^-1} + sum_v m_v ( skin g_v |d_v - o_v|^2 + prior |d_v|^2
//                                   + (1 - g_v) (out [n.d_v - b_v]_+^2 + f_v rho(t_v - n.d_v)) )
//
// m areas, L cotangent Laplacian; o what the tracked surface shows where it is skin (g falls to 0 beside the cloth);
// b how far along the normal n the cloth lies less `gap`, but no deeper than a share of the body's thickness: the body
// must stay inside (out); t where the cloth's swing over the frames tells the body to be, and f, `fit` at most, how much
// that is believed (rho: Geman-McClure, as loose cloth says nothing). After Zhang et al. 2017 (arXiv 1703.04454), own form.
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "../base/sparse.h"
#include "../base/stop.h"
#include "../geometry/body_model.h"
#include "../geometry/topology.h"

namespace toile {

struct InnerOptions {
    double length = 0.08;             ///< features shorter than this are smoothed away [m]
    double skin = 1e4;                ///< weight of observed skin
    double out = 1e3;                 ///< weight of a body that pokes out of the cloth
    double fit = 400;                 ///< pull to where the cloth's swing tells the body to be
    double fit_scale = 0.02;          ///< Geman-McClure scale of that pull [m]
    double swing = 3.2;               ///< cloth is so many standard deviations of its room over the frames off the body
    double still = 0.004;             ///< all cloth swings by so much at least: what shows less is scaled up [m]
    double swing_error = 0.004;       ///< of the body's place by cloth that does not swing [m]
    double misfit = 0.0035;           ///< seen skin that is nearer to the model, rms, says that the model holds [m]
    double prior = 0.5;               ///< coupling to the model, and of a frame to the fused shape
    double gap = 0.002;               ///< cloth stays this far off the skin [m]
    double seldom = 0.1;              ///< up to this share of the frames skin that was seen is taken for a wrong label,
    double often = 0.25;              ///< from this on for skin
    double taper = 0.02;              ///< skin counts fully only this far from the cloth, along the surface [m]
    double reach = 0.06;              ///< cloth farther than this from the body says nothing [m]
    double tightness = 0.1;           ///< the bound of a hidden vertex is this quantile over the frames
    double inward = 0.4;              ///< cloth draws a vertex inwards by at most this share of the body's thickness
    double shape_sigma = 0.01;        ///< spread of the skin about the model's span [m]
    double shape_observations = 200;  ///< independent observations that the skin counts as when the shape is refitted
    int rounds = 3;                   ///< cloth is looked for anew
    int max_iterations = 8;           ///< reweightings a round
    double tolerance = 2e-4;          ///< stop when no vertex moves by more [m]
};

struct InnerGarment {
    Vertices V;
    Faces F;
};

struct InnerFrame {
    Vertices rotations;               ///< (K,3) [rad]
    Vec3 translation = Vec3::Zero();  ///< [m]
    Vertices tracked;                 ///< (n,3) [m]
    Vector visible;                   ///< (n,) in [0,1]: 1 where the tracked surface is the inner layer
    std::vector<InnerGarment> garments;
};

struct InnerFused {
    Vertices rest;  ///< (n,3) [m]
    Vector shape;   ///< (S,) refitted to skin and cloth
    Vector bound;   ///< (n,) room between the rest and the tightest cloth along the normal [m]; infinity: none
    Stop stop = Stop::max_iterations;  ///< converged or max_iterations
    int iterations = 0;
    std::vector<double> energy;                     ///< of each iteration
    std::int64_t observed = 0;                      ///< vertices seen as skin
    std::int64_t bounded = 0;                       ///< hidden vertices with cloth in reach
    std::int64_t factorisations = 0, analyses = 0;  ///< numeric ones; symbolic ones beside the solver's own: none
};

struct InnerResult {
    Vertices V;                        ///< (n,3) [m]
    Vector skin;                       ///< (n,) share of the tracked surface in V
    Stop stop = Stop::max_iterations;  ///< converged or max_iterations
    int iterations = 0;
    std::vector<double> energy;
    double depth_before = 0;  ///< deepest hidden vertex outside the cloth, fused shape posed [m]
    double depth_after = 0;   ///< the same for V [m]
    std::int64_t outside_before = 0, outside_after = 0;  ///< their numbers
    std::int64_t factorisations = 0,
                 analyses = 0;  ///< as in InnerFused; one analysis where a part of the body is solved
};

using RoomCounts = Eigen::Matrix<std::uint32_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Where the frames of one pass of a fusion are asked what they say.
struct InnerGuess {
    Vertices rest{0, 3};       ///< (n,3) rest shape whose room to the cloth is asked for [m]; no rows: none is
    Vertices skin_mean{0, 3};  ///< (n,3) skin far from this counts less [m]; no rows: all counts alike
    bool asks_skin = true;
};

/// What frames say at one guess, summed: the sums of a sequence's blocks add up. Their size does not grow with the frames.
struct InnerSums {
    Vertices position;  ///< (n,3) weighted sum of the rest positions of skin [m]
    Vector weight;      ///< (n,) sum of those weights
    Vector skin;        ///< (n,) sum of the frames' skin
    RoomCounts room;    ///< (n,513) frames by their room from -reach to reach, in 1/256
    std::int64_t frames = 0;
    InnerSums& operator+=(const InnerSums& other);
};

/// Keeps, from its constructor on: the rest shape, its areas, smoothness operator and neighbours, and the symbolic
/// analysis of the one pattern that all solves have. Values change with what is seen in a frame, so each solve makes
/// numeric factors of its own; nothing is written while it runs, and frames may be solved side by side.
class InnerSolver {
public:
    /// shape (s,) is where the refit starts; J (K,3) the rest joints of all poses.
    InnerSolver(BodyModel model, Vector shape, Vertices J, InnerOptions options = {});

    InnerFused fuse(
        const std::vector<InnerFrame>& frames) const;  ///< all frames in memory; InnerFusion takes any number
    InnerSums sums() const;                            ///< of no frame
    void gather(const InnerFrame& frame, const InnerGuess& guess, InnerSums& sums,
                const std::string& name = "frame") const;  ///< adds one frame
    InnerResult solve(const Vertices& fused_rest, const InnerFrame& frame) const;

private:
    friend class InnerFusion;
    BodyModel model_;
    Vector shape_;
    Vertices J_;
    InnerOptions options_;
    Vertices rest_;
    Vector mass_;
    Sparse smooth_;
    CholeskyFactor analysis_;  // of smooth_, no numbers
    Adjacency neighbours_;
};

/// The fused rest shape of a sequence of any length: while not done, gather all its frames at guess(), then step. The
/// skin is averaged in three passes, frames that disagree counting less; then each round looks for the cloth anew. The solver
/// must outlive it. A call while another thread is in `step` is an InputError.
class InnerFusion {
public:
    explicit InnerFusion(const InnerSolver& solver);
    ~InnerFusion();

    bool done() const;
    InnerGuess guess() const;
    void step(const InnerSums& sums);
    InnerFused fused() const;  ///< once done

private:
    struct State;
    void average(const InnerSums& sums);
    void fit(const InnerSums& sums);

    const InnerSolver& solver_;
    InnerGuess guess_;
    std::unique_ptr<State> state_;
};

}  // namespace toile
