#include "kernels/untangle.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "base/errors.h"
#include "base/turns.h"
#include "geometry/weld.h"
#include "kernels/untangle/frame.h"

namespace toile {

namespace {

constexpr int patience = 10;        // steps without progress before giving up
constexpr int sweeps_a_step = 100;  // of the membrane, at most
constexpr double settled = 0.02;    // of the margin: the membrane's last movement

void check_options(const UntangleOptions& o) {
    auto positive = [](const char* name, double value) {
        require(std::isfinite(value) && value > 0,
                std::string("untangle: ") + name + " is " + std::to_string(value) + ", expected a positive length");
    };
    positive("margin", o.margin);
    positive("spread", o.spread);
    positive("max_depth", o.max_depth);
    require(o.relative_tolerance > 0 && o.relative_tolerance < 1,
            "untangle: relative_tolerance is " + std::to_string(o.relative_tolerance) + ", expected 0 to 1");
    require(o.max_iterations >= 1,
            "untangle: max_iterations is " + std::to_string(o.max_iterations) + ", expected at least 1");
}

// Sixth powers of lengths must stay within the range of doubles.
constexpr double largest = 1e30, smallest = 1e-30;

void check_scale(const char* name, const Vertices& V) {
    for (Eigen::Index i = 0; i < V.rows(); ++i)
        if (!(V.row(i).cwiseAbs().maxCoeff() <= largest))
            throw InputError(std::string("untangle: ") + name + "[" + std::to_string(i) + "] lies beyond 1e30");
}

void check_span(double span) { require(span >= smallest, "untangle: the faces of body_V span less than 1e-30"); }

double mean_edge(const Vertices& V, const Adjacency& ring) {
    double sum = 0;
    for (int v = 0; v < ring.size(); ++v)
        for (int k = ring.start[static_cast<std::size_t>(v)]; k < ring.start[static_cast<std::size_t>(v) + 1]; ++k)
            sum += (V.row(v) - V.row(ring.index[static_cast<std::size_t>(k)])).norm();
    return ring.index.empty() ? 0 : sum / static_cast<double>(ring.index.size());
}

/// The faces of a body, each once: the windings of a face and its reverse would cancel.
struct Distinct {
    Distinct(const Faces& F, Eigen::Index n) {
        const std::vector<int> first = first_alike(F, n);
        std::vector<int> keep;
        for (int f = 0; f < F.rows(); ++f)
            if (first[f] == f) keep.push_back(f);
        once = F(keep, Eigen::all);
        if (once.rows() == F.rows()) return;
        listings.resize(keep.size());
        for (int f = 0; f < F.rows(); ++f)
            listings[std::lower_bound(keep.begin(), keep.end(), first[f]) - keep.begin()].push_back(f);
    }

    /// Pairs with faces of `once`, as pairs with all faces given.
    Edges as_listed(const Edges& pairs) const {
        if (listings.empty()) return pairs;
        std::vector<std::array<int, 2>> all;
        for (const auto& pair : pairs.rowwise())
            for (int g : listings[pair[1]]) all.push_back({pair[0], g});
        std::sort(all.begin(), all.end());
        Edges out(static_cast<Eigen::Index>(all.size()), 2);
        for (std::size_t k = 0; k < all.size(); ++k) out.row(k) << all[k][0], all[k][1];
        return out;
    }

    Faces once;
    std::vector<std::vector<int>> listings;  ///< of each face the numbers of those given; empty: all were distinct
};

}  // namespace

struct UntangleSolver::State {
    State(Faces cloth_F, Eigen::Index n, const Faces& body_F, Eigen::Index m, const UntangleOptions& o)
        : cloth_n(n), body_n(m), options(o), cloth(std::move(cloth_F), n), membrane(cloth.ring), distinct(body_F, m),
          body(distinct.once, o.max_depth) {}

    Eigen::Index cloth_n, body_n;
    UntangleOptions options;
    Cloth cloth;
    Membrane membrane;
    Distinct distinct;
    Obstacle body;
    std::vector<int> faces_below;  ///< of the body, under the cloth's vertices at the start of the last frame
    Turn::Holder busy{0};          ///< the trees and the membrane hold the frame under way: one solve at a time
};

UntangleSolver::UntangleSolver(Faces cloth_F, Eigen::Index cloth_n, Faces body_F, Eigen::Index body_n,
                               UntangleOptions options) {
    check_options(options);
    check_mesh("untangle", Vertices::Zero(cloth_n, 3), cloth_F, "cloth_V", "cloth_F");
    check_mesh("untangle", Vertices::Zero(body_n, 3), body_F, "body_V", "body_F");
    state_ = std::make_unique<State>(std::move(cloth_F), cloth_n, body_F, body_n, options);
}

UntangleSolver::~UntangleSolver() = default;
UntangleSolver::UntangleSolver(UntangleSolver&&) noexcept = default;
UntangleSolver& UntangleSolver::operator=(UntangleSolver&&) noexcept = default;

UntangleResult UntangleSolver::solve(const Vertices& cloth_V, const Vertices& body_V) {
    State& s = *state_;
    const Turn turn(s.busy, "untangle");
    const auto rows = [](const char* name, Eigen::Index got, Eigen::Index want) {
        require(got == want, std::string("untangle: ") + name + " has " + std::to_string(got) + " rows, expected " +
                                 std::to_string(want));
    };
    rows("cloth_V", cloth_V.rows(), s.cloth_n);
    rows("body_V", body_V.rows(), s.body_n);
    check_points("untangle", "cloth_V", cloth_V);
    check_points("untangle", "body_V", body_V);
    check_scale("cloth_V", cloth_V);
    check_scale("body_V", body_V);
    const UntangleOptions& o = s.options;
    s.body.move(body_V);
    check_span(s.body.tree().nodes()[0].box.diagonal().norm());
    require(!s.body.hollow(), "untangle: body_V and body_F close on themselves around no volume: nothing is inside");
    UntangleFrame frame(cloth_V, s.cloth, s.body, o);
    const double stiffness = std::clamp(1.5 * std::pow(mean_edge(cloth_V, s.cloth.ring) / o.spread, 2), 1e-8, 1e8);

    UntangleResult r;
    frame.probe_all(s.faces_below);
    s.faces_below = frame.faces_below();
    frame.find_pairs();
    frame.decide_sides();
    r.depth_before = frame.depth();
    r.intersections_before = static_cast<int>(s.distinct.as_listed(frame.pairs).rows());
    int fewest = std::numeric_limits<int>::max();
    Vertices best, d = Vertices::Zero(s.cloth_n, 3);
    for (int idle = 0, former = std::numeric_limits<int>::max();; ++r.iterations) {
        int violations = frame.violations();
        const bool see_pairs =
            violations == 0 || 2 * violations >= former;  // stubborn ones must not keep pairs waiting
        former = violations;
        if (see_pairs) {
            if (r.iterations > 0) {
                frame.find_pairs();
                frame.decide_sides();
                violations = frame.violations();
            }
            const int left = violations + static_cast<int>(frame.pairs.rows());
            idle = left < fewest ? 0 : idle + 1;
            if (left < fewest) fewest = left, best = frame.x;
        }
        if (fewest == 0 || idle == patience || r.iterations == o.max_iterations) break;
        if (see_pairs) {
            if (frame.carry_over())
                idle = std::max(0, idle - 1);  // on the way pairs need not get fewer
            else
                frame.lift_pierced(0.25 * o.margin * std::exp2(std::min(idle, 3)));
        }
        frame.renew_planes();
        s.membrane.relax(d, frame.planes, stiffness, settled * o.margin, sweeps_a_step);
        frame.x = cloth_V + d;
        frame.probe_near();
    }
    if (fewest != 0) {
        if (best.size() > 0) frame.x = best;
        frame.probe_near();
        frame.find_pairs();
        frame.decide_sides();
    }
    r.pairs_left = s.distinct.as_listed(frame.pairs);
    r.intersections_left = static_cast<int>(r.pairs_left.rows());
    r.vertices_left = frame.vertices_inside();
    r.depth_after = frame.depth();
    r.margin = frame.margin;
    r.V = frame.x;
    check_solved("untangle", "V", r.V);
    r.displacement = frame.x - cloth_V;
    r.vertices_short = frame.violations();
    const bool clear = r.intersections_left == 0 && r.vertices_left == 0 && r.vertices_short == 0;
    r.stop = clear ? Stop::clear : r.iterations < o.max_iterations ? Stop::stalled : Stop::max_iterations;
    if (!clear) r.reason = frame.reason_left();
    return r;
}

UntangleResult untangle(const Vertices& cloth_V, const Faces& cloth_F, const Vertices& body_V, const Faces& body_F,
                        const UntangleOptions& options) {
    check_mesh("untangle", cloth_V, cloth_F, "cloth_V", "cloth_F");
    check_mesh("untangle", body_V, body_F, "body_V", "body_F");
    return UntangleSolver(cloth_F, cloth_V.rows(), body_F, body_V.rows(), options).solve(cloth_V, body_V);
}

}  // namespace toile
