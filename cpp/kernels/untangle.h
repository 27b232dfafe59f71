// Cloth out of a body: pushes along the body's outward direction, spread smoothly over the cloth, until no cloth vertex
// lies inside and no triangle pair intersects.
#pragma once
#include <memory>
#include <string>

#include "../base/stop.h"
#include "../base/types.h"

namespace toile {

struct UntangleOptions {
    double margin =
        0.002;             ///< kept between cloth and body [m]; less where the body leaves less than twice as much room
    double spread = 0.03;  ///< length over which a push dies away in the cloth [m]
    double relative_tolerance =
        0.1;                  ///< share of the margin: a vertex is clear from (1 - relative_tolerance) margin on
    double max_depth = 0.05;  ///< an open body has no inside deeper than this, overlaps are crossed no further [m]
    int max_iterations = 60;  ///< solves of the membrane
};

struct UntangleResult {
    Vertices V;                        ///< (n,3) the cloth, moved [m]
    Vertices displacement;             ///< (n,3) V - cloth_V [m]
    Vector depth_before, depth_after;  ///< (n,) how far inside the body, 0 outside [m]
    Vector margin;     ///< (n,) what was asked for at the vertex: the option, or half the room there [m]
    Edges pairs_left;  ///< (k,2) faces of cloth and body that still intersect
    int intersections_before = 0, intersections_left = 0;
    int vertices_left = 0;   ///< still inside
    int vertices_short = 0;  ///< inside or outside, nearer than (1 - relative_tolerance) of their margin
    int iterations = 0;
    Stop stop = Stop::max_iterations;  ///< clear: nothing left and nothing short; stalled or max_iterations
    std::string reason;                ///< why something is left, in words; empty when nothing is
};

/// Keeps the topology of both meshes, the order in which the membrane updates vertices, and the trees of boxes, which are
/// refitted; the faces of the body under the cloth's vertices are the next frame's guesses. There is no matrix and no
/// factor: the membrane is relaxed. Serves any number of frames, one at a time; other threads wait.
///
/// Minimises  sum over edges |d_i - d_j|^2 + 1.5 (h / spread)^2 sum_i |d_i|^2  over displacements d, subject to
/// outward_i . (x_i + d_i - b_i) >= margin_i, with h the mean edge length, b_i the closest point of the body and outward_i
/// its direction: on a regular mesh a membrane whose pushes die away by a factor of e over `spread`. Planes are renewed
/// after every solve. Where a body feature pokes through a face whose corners are clear, the corners are lifted along the
/// body's normal in the section's middle; a limb that passes right through the cloth is led to its border.
class UntangleSolver {
public:
    UntangleSolver(Faces cloth_F, Eigen::Index cloth_n, Faces body_F, Eigen::Index body_n,
                   UntangleOptions options = {});
    ~UntangleSolver();
    UntangleSolver(UntangleSolver&&) noexcept;
    UntangleSolver& operator=(UntangleSolver&&) noexcept;

    UntangleResult solve(const Vertices& cloth_V, const Vertices& body_V);

private:
    struct State;
    std::unique_ptr<State> state_;
};

UntangleResult untangle(const Vertices& cloth_V, const Faces& cloth_F, const Vertices& body_V, const Faces& body_F,
                        const UntangleOptions& options = {});

}  // namespace toile
