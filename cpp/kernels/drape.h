// Cloth that hangs on a body which moves: extended position-based dynamics.
#pragma once
#include <memory>

#include "../base/types.h"

namespace toile {

struct DrapeOptions {
    Vec3 gravity = Vec3(0, 0, -9.81);  ///< [m/s^2]
    double density = 0.2;              ///< of the cloth [kg/m^2]
    double stretch = 500;              ///< resistance to stretch [N/m]
    double bending = 1e-5;             ///< resistance to bending, of cloth that is flat at rest [N m]
    double friction = 0.6;             ///< Coulomb's coefficient between cloth and body
    double margin = 0.002;             ///< kept between the cloth's vertices and the body [m]
    double drag = 0;                   ///< share of its velocity that the cloth loses [1/s]
    double dry_drag = 0;               ///< deceleration of all that moves, by friction inside the cloth [m/s^2]
    double substep = 1.0 / 1500;       ///< longest time between two sweeps over the constraints [s]
    double max_depth = 0.05;           ///< an open body has no inside deeper than this [m]
};

struct DrapeResult {
    Vertices V;         ///< (n,3) the cloth [m]
    int contacts = 0;   ///< vertices that the body carries
    int inside = 0;     ///< vertices inside the body
    double strain = 0;  ///< of the most stretched edge: its elongation over its rest length, or a tenth of the mean one
};

/// Keeps the constraints of a cloth, their order, and trees over the faces of a body; and, from `start` on, places and
/// velocities of the cloth. One sequence at a time: InputError where two threads are at work at once.
///
/// Each substep of h seconds (Macklin, Storey, Lu et al. 2019: many small steps, one sweep each) predicts x + h v + h^2 g,
/// its v shorter by what drags take, then solves each constraint C in turn with its compliance a (Macklin, Mueller and
/// Chentanez 2016, equation 18):
///   lambda = -C / (sum_i w_i |grad_i C|^2 + a / h^2),   x_i += w_i grad_i C lambda,   w_i = 1 / mass_i.
/// Constraints: edges, C = |x_i - x_j| - length, a = length^2 / (stretch area), with the area of the edge's faces (Van
/// Gelder 1998); hinges of two faces, C = sum of cotangents times corners (Bergou et al. 2006), a = area / (3 bending).
/// Last, each vertex is kept `margin` away from the closest point of the moving body, with Coulomb friction; what pushes
/// a vertex out gives it no velocity. Cloth does not meet itself; vertices without faces stay.
class DrapeSolver {
public:
    /// `lengths` (e,) of the edges at rest, in the order of unique_edges(cloth_F) [m]; `held` vertices go where they are told.
    DrapeSolver(Faces cloth_F, Eigen::Index cloth_n, Vector lengths, Faces body_F, Eigen::Index body_n,
                Indices held = {}, DrapeOptions options = {});
    ~DrapeSolver();
    DrapeSolver(DrapeSolver&&) noexcept;
    DrapeSolver& operator=(DrapeSolver&&) noexcept;

    /// Puts the cloth at V, at rest, and lets it settle for so many seconds of heavy drag on a body that does not move.
    DrapeResult start(const Vertices& V, const Vertices& body_V, double settle = 0.5);

    /// The body goes linearly to body_V within dt seconds, held vertices to held_V (h,3); without, they stay.
    DrapeResult step(const Vertices& body_V, double dt, const Vertices& held_V = {});

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace toile
