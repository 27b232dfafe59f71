// Non-rigid registration of a template to a scan: coarse to fine, robust, the template's part prepared once.
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "../base/stop.h"
#include "../base/types.h"

namespace toile {

/// A length named `relative_...` is a share of the template's size, the square root of its area (1.4 m for an adult): the
/// same options serve every scale. Weights are shares of the data term, which sums to 1 over the template's area.
struct NricpOptions {
    bool large_motion = true;  ///< rigid steps and the first level too; false: `start` is closer than 0.03 of the size
    bool rebase = false;       ///< the rest shape, whose bending costs, is `start`, not V
    int passes = 1;            ///< solves, each but the first from the last one's answer as start and rest shape
    // One entry a level of nodes, coarse to fine.
    std::vector<double> relative_radii{0.11, 0.057, 0.032};  ///< spacing of the nodes: smaller follows finer shapes
    std::vector<int> iterations{8, 8, 3};                    ///< Gauss-Newton steps, at most; 0: no such level
    std::vector<double> stiffness_start{1, 1, 0.1};          ///< weight of rigidity at the first step,
    std::vector<double> stiffness_end{0.02, 0.02, 0.02};     ///< and at the last: smaller follows noise and clutter too
    std::vector<double> relative_robust_start{0.2, 0.036, 0.02};  ///< Geman-McClure scale at the first step,
    std::vector<double> relative_robust_end{0.07, 0.02, 0.008};   ///< and at the last; beyond 3 of it nothing pulls
    std::vector<double> reverse{5, 1, 0.1};                       ///< weight of the scan -> template term
    std::vector<double> relative_spread{0.2, 0.05, 0.03};  ///< distance that opposite normals are worth in a match
    std::vector<double> relative_detail{0.03, 0.01, 0};    ///< spacing of the vertices that are matched, 0: all
    std::vector<double> settled{0.02, 0.005, 0.02};  ///< after a move of this share of the radius only the last is left
    // The vertices' own displacement, after the levels.
    int fine_iterations = 2;              ///< steps, at most; 0: the nodes' answer
    int fine_sweeps = 8;                  ///< conjugate gradient steps each
    double relative_fine_length = 0.016;  ///< waves of the displacement shorter than this are not followed,
    double fine_noise = 10;               ///< nor those shorter than this many times the scan's noise beside
    double relative_fine_robust = 0.004;  ///< Geman-McClure scale
    // Of all levels.
    double phong = 1;  ///< share, 0 to 1, by which scan points are lifted off their faces to the smooth surface
    double point_weight =
        0.003;  ///< share of point-to-point beside point-to-plane: larger slides less along the surface
    double boundary_weight = 3;  ///< of a loop vertex against a surface vertex
    double border_weight = 3;    ///< of the pull of the scan's borders; 0: the template's own are free
    double rotation_weight = 1;  ///< on differences of neighbouring nodes' rotations, as a share of the rigidity
    double min_overlap = 0.01;   ///< matched share of the visible template below which there is no overlap
    double exposure = 0.04;      ///< share of rays that must leave the template from a visible vertex; 0: all are
    std::vector<int> labels;     ///< scan labels that are valid targets; needed with scan labels
};

/// draft | standard | fine: the one place of the presets. InputError for another name.
NricpOptions nricp_preset(const std::string& name);

struct NricpLandmarks {
    Eigen::SparseMatrix<double, Eigen::RowMajor> W;  ///< (k,n) rows are convex weights
    Vertices P;                                      ///< (k,3) [m]
    Vector sigma;                                    ///< (k,) or (1,) [m]
};

struct NricpLoop {
    Indices vertices;   ///< of the template
    Vertices polyline;  ///< (k,3) closed [m]
};

struct NricpFrame {
    Vertices V;
    Faces F;
    Vertices start;                ///< (n,3) or empty
    NricpLandmarks landmarks;      ///< or empty
    std::vector<NricpLoop> loops;  ///< or empty
    Indices labels;                ///< per face, or empty
    Vector confidence;             ///< per vertex >= 0, or empty: 1 everywhere. Faces with a corner at 0 are no target
};

struct NricpResult {
    Vertices V;                        ///< (n,3) [m]; NaN when nothing overlaps
    Stop stop = Stop::max_iterations;  ///< converged, max_iterations or no_overlap
    int iterations = 0;                ///< over all levels
    std::vector<double> energy;        ///< data energy before each step [m^2]
    double rms = 0;                    ///< weighted, of the matched vertices to the planes of their matches [m]
    Vector matched;  ///< (n,) weight of the last match in [0,1], of the sample that stands for a vertex
};

/// argmin_x sum_v a_v w_v (n_v . (x_v - q_v))^2 + reverse + borders + loops + landmarks + stiffness * rigidity(x),
/// w_v = Geman-McClure weight times squared cosine of the normals, annealed, times the confidence at q_v; x carried by a graph of rigid nodes (embedded
/// deformation), then by a smooth displacement of its own. The same bits for any number of threads.
///
/// Keeps, from its constructor on: the nodes and weights of each level, the lists that sum pulls into its normal equations,
/// and the symbolic analysis of each level and of the fine steps; every vertex that is seen and the samples that stand for
/// them. The numeric factor of the fine steps is made once for each length of waves (a power of sqrt(2)) and kept; those
/// of the levels change with every step. A target's tree is made for each scan. One solve at a time; other threads wait.
class NricpSolver {
public:
    NricpSolver(const Vertices& V, const Faces& F, const NricpOptions& options = {});
    ~NricpSolver();
    NricpSolver(NricpSolver&&) noexcept;

    NricpResult solve(const NricpFrame& frame);

    std::int64_t analyses() const;        ///< symbolic analyses so far: those of the constructor
    std::int64_t factorisations() const;  ///< numeric ones so far

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace toile
