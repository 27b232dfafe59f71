#include "kernels/drape.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "base/errors.h"
#include "base/turns.h"
#include "kernels/drape/contact.h"
#include "kernels/drape/fabric.h"

namespace toile {

namespace {

constexpr int sweeps_a_look = 5;            // substeps between two searches for the closest points of the body
constexpr double settling_drag = 10;        // of a start [1/s]
constexpr double settling_step = 1.0 / 30;  // [s]
constexpr double most_substeps = 1e6;       // of one step
constexpr double largest = 1e30;            // sixth powers of lengths must stay within the range of doubles

std::string text(double value) { return std::to_string(value); }

void check_options(const DrapeOptions& o) {
    const auto within = [](const char* name, double value, double least, bool open) {
        require(std::isfinite(value) && (open ? value > least : value >= least),
                std::string("drape: ") + name + " is " + text(value) + ", expected a number " +
                    (open ? "above 0" : "of at least 0"));
    };
    within("density", o.density, 0, true);
    within("stretch", o.stretch, 0, true);
    within("bending", o.bending, 0, false);
    within("friction", o.friction, 0, false);
    within("margin", o.margin, 0, false);
    within("drag", o.drag, 0, false);
    within("dry_drag", o.dry_drag, 0, false);
    within("substep", o.substep, 0, true);
    within("max_depth", o.max_depth, 0, true);
    require(o.gravity.allFinite(), "drape: gravity is not finite");
}

void check_places(const char* name, const Vertices& V, Eigen::Index want) {
    require(V.rows() == want, std::string("drape: ") + name + " has " + std::to_string(V.rows()) + " rows, expected " +
                                  std::to_string(want));
    check_points("drape", name, V);
    for (Eigen::Index i = 0; i < V.rows(); ++i)
        require(V.row(i).cwiseAbs().maxCoeff() <= largest,
                std::string("drape: ") + name + "[" + std::to_string(i) + "] lies beyond 1e30");
}

Vector checked_lengths(Vector lengths) {
    for (Eigen::Index e = 0; e < lengths.size(); ++e)
        require(lengths[e] >= 0 && lengths[e] <= largest,
                "drape: lengths[" + std::to_string(e) + "] is " + text(lengths[e]) + ", expected 0 to 1e30");
    return lengths;
}

}  // namespace

struct DrapeSolver::State {
    State(const Faces& cloth_F, Eigen::Index n, const Vector& lengths, const Faces& body_F, Eigen::Index m,
          Indices held_rows, const DrapeOptions& o)
        : options(o), body_n(m), held(std::move(held_rows)),
          fabric(cloth_F, n, lengths, o.density, o.stretch, o.bending),
          contact(body_F, o.margin, o.friction, o.max_depth),
          w((fabric.mass().array() > 0).select(fabric.mass().cwiseInverse(), 0)) {
        for (int i : held) w[i] = 0;
    }

    void advance(const Vertices& body_V, const Vertices& held_V, double dt, double drag);
    DrapeResult result();

    DrapeOptions options;
    Eigen::Index body_n;
    Indices held;
    Fabric fabric;
    Contact contact;
    Vector w;               ///< inverse masses, 0 of what does not move by itself [1/kg]
    Vertices x, v, before;  ///< (n,3) places [m], velocities [m/s], places before the substep
    bool started = false;
    Calls calls;
};

void DrapeSolver::State::advance(const Vertices& body_V, const Vertices& held_V, double dt, double drag) {
    const int substeps = static_cast<int>(std::ceil(dt / options.substep - 1e-9));
    const double h = dt / substeps, kept = std::exp(-drag * h), lost = options.dry_drag * h;
    contact.aim(body_V);
    Vertices held_from(held.size(), 3);
    for (Eigen::Index k = 0; k < held.size(); ++k) held_from.row(k) = x.row(held[k]);
    const Eigen::RowVector3d fall = h * options.gravity.transpose();
    for (int s = 0; s < substeps; ++s) {
        const double from = double(s) / substeps, to = double(s + 1) / substeps;
        if (s % sweeps_a_look == 0) {
            const int ahead = std::min(sweeps_a_look, substeps - s);
            // Twice the way at the present velocity, and the body's.
            const double shared = ahead * (contact.stride() / substeps + ahead * h * fall.norm());
            contact.look(x, w, (2 * ahead * h) * v.rowwise().norm() + Vector::Constant(x.rows(), shared), from);
        }
        before = x;
        for (Eigen::Index i = 0; i < x.rows(); ++i) {
            if (w[i] == 0) continue;
            const double speed = v.row(i).norm();
            v.row(i) = kept * ((speed > lost ? 1 - lost / speed : 0) * v.row(i) + fall);
            x.row(i) += h * v.row(i);
        }
        for (Eigen::Index k = 0; k < held.size(); ++k)
            x.row(held[k]) = (1 - to) * held_from.row(k) + to * held_V.row(k);
        fabric.relax(x, w, h);
        contact.push(x, before, from, to);
        v = (x - before) / h;
        contact.take_bounce(v, from, to, h);
    }
    contact.look(x, w, Vector::Constant(x.rows(), 0), 1);
    contact.arrive();
}

DrapeResult DrapeSolver::State::result() {
    check_solved("drape", "V", x);
    DrapeResult r;
    r.V = x;
    r.contacts = contact.contacts();
    r.inside = contact.inside();
    r.strain = fabric.strain(x);
    return r;
}

DrapeSolver::DrapeSolver(Faces cloth_F, Eigen::Index cloth_n, Vector lengths, Faces body_F, Eigen::Index body_n,
                         Indices held, DrapeOptions options) {
    check_options(options);
    check_mesh("drape", Vertices::Zero(cloth_n, 3), cloth_F, "cloth_V", "cloth_F");
    check_mesh("drape", Vertices::Zero(body_n, 3), body_F, "body_V", "body_F");
    check_indices("drape", "held", held, cloth_n);
    state_ = std::make_unique<State>(cloth_F, cloth_n, checked_lengths(std::move(lengths)), body_F, body_n,
                                     std::move(held), options);
}

DrapeSolver::~DrapeSolver() = default;
DrapeSolver::DrapeSolver(DrapeSolver&&) noexcept = default;
DrapeSolver& DrapeSolver::operator=(DrapeSolver&&) noexcept = default;

DrapeResult DrapeSolver::start(const Vertices& V, const Vertices& body_V, double settle) {
    State& s = *state_;
    const Calls::Writing alone(s.calls, "drape");
    check_places("V", V, s.w.size());
    check_places("body_V", body_V, s.body_n);
    require(settle >= 0 && settle / s.options.substep <= most_substeps,
            "drape: settle is " + text(settle) + " s, expected 0 to a million substeps");
    s.contact.place(body_V);
    require(!s.contact.body().hollow(),
            "drape: body_V and body_F close on themselves around no volume: nothing is inside");
    s.x = V;
    s.v = Vertices::Zero(V.rows(), 3);
    s.started = true;
    const Vertices held_V = V(s.held, Eigen::all);
    for (double left = settle; left > 0; left -= settling_step)
        s.advance(body_V, held_V, std::min(left, settling_step), settling_drag);
    s.v.setZero();
    if (settle == 0) s.contact.look(s.x, s.w, Vector::Zero(V.rows()), 0);
    return s.result();
}

DrapeResult DrapeSolver::step(const Vertices& body_V, double dt, const Vertices& held_V) {
    State& s = *state_;
    const Calls::Writing alone(s.calls, "drape");
    require(s.started, "drape: step without start");
    check_places("body_V", body_V, s.body_n);
    require(dt > 0 && dt / s.options.substep <= most_substeps,
            "drape: dt is " + text(dt) + " s, expected above 0 and at most a million substeps");
    if (held_V.rows() > 0) check_places("held_V", held_V, s.held.size());
    s.advance(body_V, held_V.rows() > 0 ? held_V : Vertices(s.x(s.held, Eigen::all)), dt, s.options.drag);
    return s.result();
}

}  // namespace toile
