#include "kernels/untangle.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "base/errors.h"
#include "base/parallel.h"
#include "base/sparse.h"
#include "geometry/intersect.h"
#include "geometry/obstacle.h"
#include "geometry/topology.h"

namespace toile {

namespace {

constexpr double hold = 1e4;         // weight of an active vertex against the spread's diagonal entries
constexpr int releases_allowed = 2;  // so that the active set cannot cycle
constexpr int refinements = 3;       // active-set passes over the first planes; later planes get one
constexpr int patience = 10;         // steps without progress before giving up

void check_options(const UntangleOptions& o) {
    auto positive = [](const char* name, double value) {
        require(std::isfinite(value) && value > 0,
                std::string("untangle: ") + name + " is " + std::to_string(value) + ", expected a positive length");
    };
    positive("margin", o.margin);
    positive("spread", o.spread);
    positive("max_depth", o.max_depth);
    require(o.tolerance > 0 && o.tolerance < 1,
            "untangle: tolerance is " + std::to_string(o.tolerance) + ", expected 0 to 1");
    require(o.max_iterations >= 1,
            "untangle: max_iterations is " + std::to_string(o.max_iterations) + ", expected at least 1");
}

/// L'L of the uniform graph Laplacian, with every diagonal entry present.
Sparse spread_matrix(const Faces& F, Eigen::Index n) {
    const Adjacency ring = vertex_neighbours(F, n);
    std::vector<Eigen::Triplet<double>> entries;
    for (int v = 0; v < n; ++v) {
        const auto begin = static_cast<std::size_t>(ring.start[static_cast<std::size_t>(v)]),
                   end = static_cast<std::size_t>(ring.start[static_cast<std::size_t>(v) + 1]);
        if (begin == end) continue;
        entries.emplace_back(v, v, 1.0);
        const double share = 1.0 / static_cast<double>(end - begin);
        for (std::size_t k = begin; k < end; ++k) entries.emplace_back(v, ring.index[k], -share);
    }
    Sparse L(n, n), zero(n, n);
    L.setFromTriplets(entries.begin(), entries.end());
    zero.setIdentity();
    zero *= 0.0;
    Sparse LtL = Sparse(L.transpose()) * L;
    Sparse out = LtL + zero;
    out.makeCompressed();
    return out;
}

double mean_edge(const Vertices& V, const Edges& edges) {
    double sum = 0;
    for (Eigen::Index e = 0; e < edges.rows(); ++e) sum += (V.row(edges(e, 0)) - V.row(edges(e, 1))).norm();
    return edges.rows() > 0 ? sum / static_cast<double>(edges.rows()) : 0;
}

/// Where edge pq crosses the triangle abc; false if it does not. Plain arithmetic: only the size of a push depends on it.
bool crossing(const Vec3& p, const Vec3& q, const Vec3& a, const Vec3& b, const Vec3& c, Vec3& x) {
    const Vec3 n = (b - a).cross(c - a);
    const double s = n.dot(p - a), e = n.dot(q - a);
    if (s * e > 0 || s == e) return false;
    x = p + (q - p) * (s / (s - e));
    return n.dot((b - a).cross(x - a)) >= 0 && n.dot((c - b).cross(x - b)) >= 0 && n.dot((a - c).cross(x - c)) >= 0;
}

}  // namespace

struct UntangleSolver::State {
    Faces cloth_F, body_F;
    Eigen::Index cloth_n, body_n;
    UntangleOptions options;
    SideTopology sides;
    Edges cloth_edges;
    Sparse spread;
    CholeskyFactor factor;
};

namespace {

/// One frame: positions, planes and the active set, moved forward step by step.
struct Frame {
    const Vertices& start;
    const Vertices& body_V;
    const Faces& F;
    const Faces& body_F;
    const UntangleOptions& options;
    Obstacle body;
    TriangleIndex body_faces;

    Vertices x;
    std::vector<Probe> probes, start_probes;
    Vector margin;         // half the room at most [m]
    std::vector<char> active, releases;
    Vertices target;       // displacement of active vertices from the start
    Vertices way;          // of active vertices: the unit direction of their last push
    Vertices nudge;        // for the next planes: pushes of the corners of pierced faces

    /// Where every vertex stands. A quick look trusts normals alone; what it calls clear is looked at again.
    void look(bool quick) {
        probes = quick ? body.probe_each_quickly(x, probes) : body.probe_each(x, start, start_probes);
        ask_margins();
    }
    void first_look() {
        probes = start_probes = body.probe_each(x);
        ask_margins();
    }
    void ask_margins() {
        parallel_for(x.rows(), [&](std::int64_t i) {
            const Probe& p = probes[static_cast<std::size_t>(i)];
            if (p.constrained && p.distance < options.margin)
                margin[i] = std::min(options.margin, body.room(p, 2 * options.margin) / 2);
        }, 64);
    }
    bool violated(Eigen::Index i) const {
        const Probe& p = probes[static_cast<std::size_t>(i)];
        return p.constrained && p.distance < (1 - options.tolerance) * margin[i];
    }
    int violations() const {
        int count = 0;
        for (Eigen::Index i = 0; i < x.rows(); ++i) count += violated(i);
        return count;
    }
    int inside() const {
        return static_cast<int>(std::count_if(probes.begin(), probes.end(), [](const Probe& p) { return p.inside(); }));
    }
    Vector depth() const {
        Vector d(x.rows());
        for (Eigen::Index i = 0; i < d.size(); ++i) d[i] = std::max(0.0, -probes[static_cast<std::size_t>(i)].distance);
        return d;
    }

    /// New members of the active set, and the planes of all members at the present position.
    void renew_planes() {
        for (Eigen::Index i = 0; i < x.rows(); ++i) {
            const auto k = static_cast<std::size_t>(i);
            const Probe& p = probes[k];
            const Vec3 push = nudge.row(i);
            if (violated(i) || push != Vec3::Zero()) active[k] = 1;
            if (!active[k]) continue;
            const double rise = p.constrained ? std::max(0.0, margin[i] - p.distance) : 0;
            target.row(i) = x.row(i) - start.row(i) + rise * p.outward.transpose() + push.transpose();
            if (push != Vec3::Zero()) way.row(i) = push.normalized();
            if (rise > 0) way.row(i) = p.outward;
        }
        nudge.setZero();
    }

    /// The middle of the curve along which cloth face f meets the given body faces.
    Vec3 middle_of_section(int f, const std::vector<int>& partners) const {
        const auto corner = [](const Vertices& V, const Faces& G, int g, int c) { return Vec3(V.row(G(g, c % 3))); };
        Vec3 sum = Vec3::Zero(), at;
        int count = 0;
        for (int g : partners)
            for (int c = 0; c < 3; ++c) {
                if (crossing(corner(x, F, f, c), corner(x, F, f, c + 1), corner(body_V, body_F, g, 0),
                             corner(body_V, body_F, g, 1), corner(body_V, body_F, g, 2), at))
                    sum += at, ++count;
                if (crossing(corner(body_V, body_F, g, c), corner(body_V, body_F, g, c + 1), corner(x, F, f, 0),
                             corner(x, F, f, 1), corner(x, F, f, 2), at))
                    sum += at, ++count;
            }
        if (count == 0) return (corner(x, F, f, 0) + corner(x, F, f, 1) + corner(x, F, f, 2)) / 3;
        return sum / count;
    }

    /// Corners of pierced faces are pushed out of the body so that the face clears the depth found in the section's middle.
    /// At least by `least` [m]: a section that ends at the face's rim has its middle near the surface and tells no depth.
    void raise_pierced(const Edges& pairs, double least) {
        for (Eigen::Index k = 0, end; k < pairs.rows(); k = end) {
            const int f = pairs(k, 0);
            std::vector<int> partners;
            for (end = k; end < pairs.rows() && pairs(end, 0) == f; ++end) partners.push_back(pairs(end, 1));
            const Vec3 middle = middle_of_section(f, partners);
            const Probe p = body.probe(middle);
            const Vec3 b = closest_on_triangle(middle, x.row(F(f, 0)), x.row(F(f, 1)), x.row(F(f, 2))).barycentric;
            if (!p.constrained && std::abs(p.distance) > 0.5 * options.margin) continue;  // on the surface any side will do
            const double lift = std::max(0.0, -p.distance) + least;
            for (int c = 0; c < 3; ++c) {
                const double rise = lift * b[c] / b.squaredNorm();
                if (rise > nudge.row(F(f, c)).norm()) nudge.row(F(f, c)) = rise * p.outward;
            }
        }
    }
};

}  // namespace

UntangleSolver::UntangleSolver(Faces cloth_F, Eigen::Index cloth_n, Faces body_F, Eigen::Index body_n, UntangleOptions options) {
    check_options(options);
    check_mesh("untangle", Vertices::Zero(cloth_n, 3), cloth_F, "cloth_V", "cloth_F");
    check_mesh("untangle", Vertices::Zero(body_n, 3), body_F, "body_V", "body_F");
    state_ = std::make_unique<State>(State{cloth_F, body_F, cloth_n, body_n, options, SideTopology(body_F),
                                           unique_edges(cloth_F), spread_matrix(cloth_F, cloth_n), {}});
    state_->factor.analyze(state_->spread);
}

UntangleSolver::~UntangleSolver() = default;
UntangleSolver::UntangleSolver(UntangleSolver&&) noexcept = default;
UntangleSolver& UntangleSolver::operator=(UntangleSolver&&) noexcept = default;

std::int64_t UntangleSolver::analyses() const { return state_->factor.analyses(); }
std::int64_t UntangleSolver::factorisations() const { return state_->factor.factorisations(); }

namespace {

/// d of least energy with active vertices held at their targets; vertices that the others would carry further out than
/// their plane asks are released, and the rest is solved again.
Vertices spread_targets(const Sparse& spread, double weight, CholeskyFactor& factor, Frame& frame, int passes) {
    const Eigen::Index n = frame.x.rows();
    const double held_weight = hold * (1 + weight);
    Vertices d;
    for (int pass = 0, released = 1; released > 0 && pass < passes; ++pass) {
        Sparse A = spread;
        Matrix rhs = Matrix::Zero(n, 3);
        for (Eigen::Index i = 0; i < n; ++i) {
            const bool held = frame.active[static_cast<std::size_t>(i)] != 0;
            A.coeffRef(i, i) += weight + (held ? held_weight : 0.0);
            if (held) rhs.row(i) = held_weight * frame.target.row(i);
        }
        factor.factorize(A);
        d = factor.solve(rhs);
        released = 0;
        for (Eigen::Index i = 0; i < n; ++i) {
            const auto k = static_cast<std::size_t>(i);
            const double multiplier = (frame.target.row(i) - d.row(i)).dot(frame.way.row(i));
            const bool needed = multiplier > -1e-5 * frame.options.margin;  // beyond rounding
            if (!frame.active[k] || needed || frame.releases[k] >= releases_allowed) continue;
            frame.active[k] = 0;
            ++frame.releases[k];
            ++released;
        }
    }
    for (Eigen::Index i = 0; i < n; ++i)
        if (frame.active[static_cast<std::size_t>(i)]) d.row(i) = frame.target.row(i);  // what `hold` leaves open
    return d;
}

std::string reason_left(const UntangleResult& r, const Frame& frame) {
    int overlap = 0, tight = 0;
    for (Eigen::Index i = 0; i < frame.x.rows(); ++i) {
        const Probe& p = frame.probes[static_cast<std::size_t>(i)];
        if (p.inside() && !p.constrained) ++overlap;
        if (r.margin[i] < 0.25 * frame.options.margin) ++tight;
    }
    const auto text = [](int count) { return std::to_string(count); };
    std::string why = text(r.vertices_left) + " vertices inside, " + text(r.intersections_left) + " pairs left";
    if (overlap > 0) why += "; " + text(overlap) + " vertices lie where the body overlaps itself";
    if (tight > 0) why += "; " + text(tight) + " vertices have less room than half the margin between two parts of the body";
    if (overlap == 0 && tight == 0)
        why += "; the body passes through the cloth further than pushes along its normals can mend";
    return why;
}

}  // namespace

UntangleResult UntangleSolver::solve(const Vertices& cloth_V, const Vertices& body_V) {
    State& s = *state_;
    const auto rows = [](const char* name, Eigen::Index got, Eigen::Index want) {
        require(got == want, std::string("untangle: ") + name + " has " + std::to_string(got) + " rows, expected " +
                                 std::to_string(want));
    };
    rows("cloth_V", cloth_V.rows(), s.cloth_n);
    rows("body_V", body_V.rows(), s.body_n);
    check_finite("untangle", "cloth_V", cloth_V);
    check_finite("untangle", "body_V", body_V);
    const UntangleOptions& o = s.options;
    const auto n = static_cast<std::size_t>(s.cloth_n);
    const Vertices nothing = Vertices::Zero(s.cloth_n, 3);
    Frame frame{cloth_V, body_V, s.cloth_F, s.body_F, o, Obstacle(body_V, s.body_F, s.sides, o.max_depth),
                TriangleIndex(body_V, s.body_F), cloth_V, {}, {}, Vector::Constant(s.cloth_n, o.margin),
                std::vector<char>(n, 0), std::vector<char>(n, 0), nothing, nothing, nothing};
    // From a spread of h/20 on nothing spreads; from 150 h on all of the cloth moves.
    const double weight = std::clamp(std::pow(mean_edge(cloth_V, s.cloth_edges) / (2 * o.spread), 4), 1e-10, 1e4);

    UntangleResult r;
    frame.first_look();
    r.depth_before = frame.depth();
    r.intersections_before = static_cast<int>(frame.body_faces.pairs(frame.x, s.cloth_F).rows());
    constexpr int unseen = std::numeric_limits<int>::max();
    std::pair<int, int> fewest{unseen, unseen};  // vertices to move, then pairs
    Vertices best;
    for (int idle = 0, former = unseen;; ++r.iterations) {
        int violations = frame.violations();
        if (violations == 0 && r.iterations > 0) {
            frame.look(false);
            violations = frame.violations();
        }
        const bool see_pairs = violations == 0 || violations >= former;  // stubborn vertices must not keep pairs waiting
        former = violations;
        if (see_pairs) r.pairs_left = frame.body_faces.pairs(frame.x, s.cloth_F);
        const std::pair<int, int> left{violations, see_pairs ? static_cast<int>(r.pairs_left.rows()) : unseen};
        idle = left < fewest ? 0 : idle + 1;
        if (left < fewest) fewest = left, best = frame.x;
        if (left == std::pair(0, 0) || idle == patience || r.iterations == o.max_iterations) break;
        if (see_pairs) frame.raise_pierced(r.pairs_left, 0.25 * o.margin * std::exp2(std::min(idle, 3)));
        frame.renew_planes();
        frame.x = cloth_V + spread_targets(s.spread, weight, s.factor, frame, refinements);
        frame.look(true);
    }
    if (fewest != std::pair(0, 0)) {
        frame.x = best;
        frame.look(false);
    }
    r.pairs_left = frame.body_faces.pairs(frame.x, s.cloth_F);
    r.intersections_left = static_cast<int>(r.pairs_left.rows());
    r.vertices_left = frame.inside();
    r.depth_after = frame.depth();
    r.margin = frame.margin;
    r.V = frame.x;
    r.displacement = frame.x - cloth_V;
    const bool clear = r.intersections_left == 0 && r.vertices_left == 0;
    r.stop = r.iterations < o.max_iterations ? (clear ? "clear" : "stalled") : "iterations";
    if (!clear) r.reason = reason_left(r, frame);
    return r;
}

UntangleResult untangle(const Vertices& cloth_V, const Faces& cloth_F, const Vertices& body_V, const Faces& body_F,
                        const UntangleOptions& options) {
    check_mesh("untangle", cloth_V, cloth_F, "cloth_V", "cloth_F");
    check_mesh("untangle", body_V, body_F, "body_V", "body_F");
    return UntangleSolver(cloth_F, cloth_V.rows(), body_F, body_V.rows(), options).solve(cloth_V, body_V);
}

}  // namespace toile
