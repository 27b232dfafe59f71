#include "kernels/untangle.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <utility>
#include <vector>

#include "base/errors.h"
#include "base/parallel.h"
#include "geometry/box_tree.h"
#include "geometry/intersect.h"
#include "geometry/membrane.h"
#include "geometry/obstacle.h"
#include "geometry/topology.h"

namespace toile {

namespace {

constexpr int carries_allowed = 20;       // of a vertex, so that none goes to and fro
constexpr int patience = 10;             // steps without progress before giving up
constexpr int sweeps_a_step = 100;       // of the membrane, at most
constexpr double settled = 0.02;         // of the margin: the membrane's last movement
constexpr double least_margin = 0.01;    // of the margin, between parts that leave no room
constexpr double watched = 2;            // margins: vertices nearer than this are kept from the body

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

double mean_edge(const Vertices& V, const Adjacency& ring) {
    double sum = 0;
    for (int v = 0; v < ring.size(); ++v)
        for (int k = ring.start[static_cast<std::size_t>(v)]; k < ring.start[static_cast<std::size_t>(v) + 1]; ++k)
            sum += (V.row(v) - V.row(ring.index[static_cast<std::size_t>(k)])).norm();
    return ring.index.empty() ? 0 : sum / static_cast<double>(ring.index.size());
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
    Faces cloth_F;
    Eigen::Index cloth_n, body_n;
    UntangleOptions options;
    Adjacency ring;           ///< of the cloth
    std::vector<int> to_rim;  ///< edges to the nearest rim
    Membrane membrane;
    Obstacle body;
    std::optional<BoxTree> cloth_tree;
    std::vector<int> tour;         ///< vertices of the cloth, neighbours in space one after the other
    std::vector<int> faces_below;  ///< of the body, under the cloth's vertices in the last frame
};

namespace {

/// Vertices in the order in which the tree's faces name them, then those of no face.
std::vector<int> tour_of(const BoxTree& tree, const Faces& F, Eigen::Index n) {
    std::vector<int> tour;
    std::vector<char> seen(static_cast<std::size_t>(n), 0);
    const auto visit = [&](int v) {
        if (!std::exchange(seen[static_cast<std::size_t>(v)], 1)) tour.push_back(v);
    };
    for (int f : tree.order())
        for (int c = 0; c < 3; ++c) visit(F(f, c));
    for (int v = 0; v < n; ++v) visit(v);
    return tour;
}

/// Edges from each vertex to the nearest rim; the largest int where the cloth has none.
std::vector<int> steps_to_rim(const Faces& F, const Adjacency& ring) {
    const std::vector<char> rim = boundary_vertices(F, ring.size());
    std::vector<int> steps(rim.size(), std::numeric_limits<int>::max()), queue;
    for (int v = 0; v < ring.size(); ++v)
        if (rim[static_cast<std::size_t>(v)]) steps[static_cast<std::size_t>(v)] = 0, queue.push_back(v);
    for (std::size_t head = 0; head < queue.size(); ++head) {
        const auto v = static_cast<std::size_t>(queue[head]);
        for (int k = ring.start[v]; k < ring.start[v + 1]; ++k) {
            const int w = ring.index[static_cast<std::size_t>(k)];
            if (steps[static_cast<std::size_t>(w)] != std::numeric_limits<int>::max()) continue;
            steps[static_cast<std::size_t>(w)] = steps[v] + 1;
            queue.push_back(w);
        }
    }
    return steps;
}

/// Groups of vertices, each named by its smallest.
struct Groups {
    std::vector<int> parent;
    explicit Groups(Eigen::Index n) : parent(static_cast<std::size_t>(n)) { std::iota(parent.begin(), parent.end(), 0); }
    int of(int v) {
        int root = v;
        while (parent[static_cast<std::size_t>(root)] != root) root = parent[static_cast<std::size_t>(root)];
        while (parent[static_cast<std::size_t>(v)] != root) v = std::exchange(parent[static_cast<std::size_t>(v)], root);
        return root;
    }
    void join(int v, int w) {
        v = of(v), w = of(w);
        parent[static_cast<std::size_t>(std::max(v, w))] = std::min(v, w);
    }
};

/// One frame: the cloth's positions, what they see of the body, and the half-spaces that keep them out of it.
struct Frame {
    const Vertices& start;
    const Faces& F;
    const UntangleOptions& options;
    const Obstacle& body;
    BoxTree& tree;
    const std::vector<int>& tour;

    Vertices x, probed_at;
    std::vector<Probe> probes;
    Vector margin;                  // half the room at most [m]
    std::vector<char> was_violated;
    std::vector<int> carries;       // how often a vertex was asked to change sides
    std::vector<char> carried;      // to another side of the body in the coming step
    std::vector<char> given_up;     // the body gave no direction where the vertex was when its side was decided
    std::vector<HalfSpaces> planes; // of the last step
    std::vector<HalfSpaces> creases;  // the other side of a crease
    std::vector<HalfSpaces> lifts;  // of corners of pierced faces; stay for the frame
    Vertices pushes;                // the sum of what lifted a vertex
    Edges pairs;

    Frame(const Vertices& cloth_V, const Faces& cloth_F, const UntangleOptions& o, const Obstacle& obstacle, BoxTree& cloth_tree,
          const std::vector<int>& order)
        : start(cloth_V), F(cloth_F), options(o), body(obstacle), tree(cloth_tree), tour(order), x(cloth_V), probed_at(cloth_V),
          probes(static_cast<std::size_t>(cloth_V.rows())), margin(Vector::Constant(cloth_V.rows(), o.margin)),
          was_violated(probes.size(), 0), carries(probes.size(), 0), carried(probes.size(), 0), given_up(probes.size(), 0), planes(probes.size()), creases(probes.size()), lifts(probes.size()),
          pushes(Vertices::Zero(cloth_V.rows(), 3)) {}

    Probe& at(Eigen::Index i) { return probes[static_cast<std::size_t>(i)]; }
    const Probe& at(Eigen::Index i) const { return probes[static_cast<std::size_t>(i)]; }

    /// The first look: every vertex, from a guess or from the face of the vertex before it.
    void probe_all(const std::vector<int>& guesses) {
        constexpr Eigen::Index block = 64;
        parallel_for((x.rows() + block - 1) / block, [&](std::int64_t b) {
            int guess = -1;
            for (Eigen::Index k = b * block; k < std::min(x.rows(), (b + 1) * block); ++k) {
                const int i = tour[static_cast<std::size_t>(k)];
                at(i) = body.probe(x.row(i), guesses.empty() ? guess : guesses[static_cast<std::size_t>(i)]);
                guess = at(i).face;
            }
        }, 1);
    }

    /// Free distance that vertex i is sure of where it is now [m].
    double sure_distance(Eigen::Index i) const {
        return std::abs(at(i).distance) - (x.row(i) - probed_at.row(i)).norm();
    }
    bool known_clear(Eigen::Index i) const { return !at(i).inside() && sure_distance(i) > watched * options.margin; }

    /// Looks again where a vertex may have come near, by normals alone.
    void probe_near() {
        parallel_for(x.rows(), [&](std::int64_t k) {
            const int i = tour[static_cast<std::size_t>(k)];
            if (known_clear(i)) return;
            at(i) = body.probe(x.row(i), at(i).face);
            probed_at.row(i) = x.row(i);
            if (given_up[static_cast<std::size_t>(i)]) at(i).constrained = false;
            shrink_margin(i);
        }, 64);
    }

    /// Where a vertex that was pushed off one part now stands too near to another that faces it, the two meet in the
    /// middle: it was `margin` from the first plane, so half of both distances is half the room.
    void shrink_margin(Eigen::Index i) {
        const HalfSpaces& last = planes[static_cast<std::size_t>(i)];
        const Probe& p = at(i);
        if (!violated(i) || last.count == 0 || last.normal[0].dot(p.outward) >= 0 || p.distance < -1.1 * margin[i]) return;
        margin[i] = std::max(0.5 * (margin[i] + p.distance), least_margin * options.margin);
    }

    /// Exact pairs. A face is left out when balls at its corners that hold nothing of the body cover it: every point of a
    /// triangle lies within longest edge / sqrt(3) of a corner.
    void find_pairs() {
        std::vector<char> hidden(static_cast<std::size_t>(F.rows()));
        parallel_for(F.rows(), [&](std::int64_t f) {
            double free = std::numeric_limits<double>::infinity(), longest = 0;
            for (int c = 0; c < 3; ++c) {
                free = std::min(free, sure_distance(F(f, c)));
                longest = std::max(longest, (x.row(F(f, c)) - x.row(F(f, (c + 1) % 3))).norm());
            }
            hidden[static_cast<std::size_t>(f)] = free > 0.578 * longest;
        });
        tree.refit(x, F, hidden);
        pairs = meeting_faces(tree, body.tree());
    }

    /// Sides by the winding number. It is constant along faces that do not meet the body, and along edges covered by
    /// balls that hold nothing of it; so one look serves a whole group of vertices.
    void decide_sides() {
        if (!body.closed()) return;
        std::vector<char> pierced(static_cast<std::size_t>(F.rows()), 0);
        for (Eigen::Index k = 0; k < pairs.rows(); ++k) pierced[static_cast<std::size_t>(pairs(k, 0))] = 1;
        Groups groups(x.rows());
        for (Eigen::Index f = 0; f < F.rows(); ++f)
            for (int c = 0; c < 3; ++c) {
                const int i = F(f, c), j = F(f, (c + 1) % 3);
                const bool covered = !pierced[static_cast<std::size_t>(f)] ||
                                     (x.row(i) - x.row(j)).norm() < (1 - 1e-9) * (sure_distance(i) + sure_distance(j));
                if (covered) groups.join(i, j);
            }
        std::vector<int> speaker(probes.size(), -1);  // the vertex of a group that is farthest from the body
        for (int i = 0; i < x.rows(); ++i) {
            int& s = speaker[static_cast<std::size_t>(groups.of(i))];
            if (s < 0 || std::abs(at(i).distance) > std::abs(at(s).distance)) s = i;
        }
        std::vector<char> inside(probes.size(), 0);
        parallel_for(x.rows(), [&](std::int64_t i) {
            const int s = speaker[static_cast<std::size_t>(i)];
            if (s >= 0) inside[static_cast<std::size_t>(i)] = body.inside(x.row(s));
        }, 64);
        for (int i = 0; i < x.rows(); ++i) {
            const auto k = static_cast<std::size_t>(i);
            if (!known_clear(i) || inside[static_cast<std::size_t>(groups.of(i))])
                body.decide(probes[k], inside[static_cast<std::size_t>(groups.of(i))]);
            given_up[k] = probes[k].inside() && !probes[k].constrained && !body.pass_through(x.row(i), probes[k]);
        }
    }

    bool violated(Eigen::Index i) const { return at(i).constrained && at(i).distance < (1 - options.tolerance) * margin[i]; }
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
        for (Eigen::Index i = 0; i < d.size(); ++i) d[i] = std::max(0.0, -at(i).distance);
        return d;
    }

    /// A limb that passes right through faces stands between their corners. The corners nearer to the cloth's rim are
    /// carried over to the side of the others, so that from step to step the hole travels to the rim and off the cloth.
    bool carry_over(const std::vector<int>& to_rim) {
        bool any = false;
        for (Eigen::Index k = 0, end; k < pairs.rows(); k = end) {
            const int f = pairs(k, 0);
            for (end = k; end < pairs.rows() && pairs(end, 0) == f;) ++end;
            for (int c = 0; c < 3; ++c) {
                int i = F(f, c), j = F(f, (c + 1) % 3);
                if (at(i).outward.dot(at(j).outward) >= 0) continue;
                bool cut = false;
                for (Eigen::Index g = k; g < end && !cut; ++g) {
                    const BoxTree::Triangle& t = body.tree().triangle(body.tree().slot_of(pairs(g, 1)));
                    Vec3 where;
                    cut = crossing(x.row(i), x.row(j), t.a, t.b, t.c, where);
                }
                if (!cut) continue;
                if (std::pair(to_rim[static_cast<std::size_t>(i)], i) > std::pair(to_rim[static_cast<std::size_t>(j)], j)) std::swap(i, j);
                if (!carried[static_cast<std::size_t>(i)] && carries[static_cast<std::size_t>(i)]++ >= carries_allowed) continue;
                carried[static_cast<std::size_t>(i)] = 1;
                HalfSpaces& h = lifts[static_cast<std::size_t>(i)];
                h.count = 1;
                h.normal[0] = at(j).outward;
                h.least[0] = at(j).outward.dot(at(j).point - start.row(i).transpose()) + margin[j];
                pushes.row(i).setZero();
                any = true;
            }
        }
        return any;
    }

    /// The plane at the closest point for every vertex near the body, and what pierced faces asked for.
    void renew_planes() {
        parallel_for(x.rows(), [&](std::int64_t i) {
            const auto k = static_cast<std::size_t>(i);
            const HalfSpaces last = std::exchange(planes[k], {});
            HalfSpaces& h = planes[k];
            if (std::exchange(carried[k], 0)) {
                h = std::exchange(lifts[k], {});
                return;
            }
            const Probe& p = at(i);
            if (violated(i)) {
                // Still outside, but pushed off one side too near to another: a crease, kept from both sides.
                const bool crease = pairs.rows() == 0 && was_violated[k] && last.count > 0 && !p.inside();
                if (crease) creases[k] = {{last.normal[0], Vec3::Zero()}, {last.least[0], 0}, 1};
                was_violated[k] = 1;
            }
            if (p.constrained && (was_violated[k] || p.distance < watched * options.margin)) {
                h.normal[0] = p.outward;
                h.least[0] = p.outward.dot(p.point - start.row(i).transpose()) + margin[i];
                h.count = 1;
            }
            if (pairs.rows() > 0) creases[k] = {};
            const HalfSpaces& second = lifts[k].count > 0 ? lifts[k] : creases[k];
            if (second.count == 0) return;
            h.normal[h.count] = second.normal[0];
            h.least[h.count++] = second.least[0];
        });
    }

    /// The middle of the curve along which cloth face f meets the given body faces.
    Vec3 middle_of_section(int f, const std::vector<int>& partners) const {
        const Vec3 mine[3] = {x.row(F(f, 0)), x.row(F(f, 1)), x.row(F(f, 2))};
        Vec3 sum = Vec3::Zero(), where;
        int count = 0;
        for (int g : partners) {
            const BoxTree::Triangle& t = body.tree().triangle(body.tree().slot_of(g));
            const Vec3 theirs[3] = {t.a, t.b, t.c};
            for (int c = 0; c < 3; ++c) {
                if (crossing(mine[c], mine[(c + 1) % 3], t.a, t.b, t.c, where)) sum += where, ++count;
                if (crossing(theirs[c], theirs[(c + 1) % 3], mine[0], mine[1], mine[2], where)) sum += where, ++count;
            }
        }
        return count == 0 ? Vec3((mine[0] + mine[1] + mine[2]) / 3) : Vec3(sum / count);
    }

    /// Corners of pierced faces are lifted out of the body so that the face clears the depth found in the section's middle.
    /// At least by `least` [m]: a section that ends at the face's rim has its middle near the surface and tells no depth.
    void lift_pierced(double least) {
        Vector lifted = Vector::Zero(x.rows());
        Vertices push = Vertices::Zero(x.rows(), 3);
        for (Eigen::Index k = 0, end; k < pairs.rows(); k = end) {
            const int f = pairs(k, 0);
            std::vector<int> partners;
            for (end = k; end < pairs.rows() && pairs(end, 0) == f; ++end) partners.push_back(pairs(end, 1));
            const Vec3 middle = middle_of_section(f, partners);
            Probe p = body.probe(middle);
            if (body.closed()) body.decide(p, body.inside(middle));
            if (p.inside() && !p.constrained) body.pass_through(middle, p);
            if (!p.constrained && std::abs(p.distance) > 0.5 * options.margin) continue;  // on the surface any side will do
            const Vec3 b = closest_on_triangle(middle, x.row(F(f, 0)), x.row(F(f, 1)), x.row(F(f, 2))).barycentric;
            const double lift = std::max(0.0, -p.distance) + least;
            for (int c = 0; c < 3; ++c) {
                const int i = F(f, c);
                const double rise = lift * b[c] / b.squaredNorm();
                if (rise <= lifted[i]) continue;
                lifted[i] = rise;
                push.row(i) = rise * p.outward;
            }
        }
        for (Eigen::Index i = 0; i < x.rows(); ++i) {
            if (lifted[i] == 0) continue;
            HalfSpaces& h = lifts[static_cast<std::size_t>(i)];
            pushes.row(i) += push.row(i);  // of two flanks of a ridge: up
            const Vec3 way = pushes.row(i).transpose().normalized();
            h.count = 1;
            h.normal[0] = way;
            h.least[0] = way.dot((x.row(i) - start.row(i) + push.row(i)).transpose());
        }
    }
};

}  // namespace

UntangleSolver::UntangleSolver(Faces cloth_F, Eigen::Index cloth_n, Faces body_F, Eigen::Index body_n, UntangleOptions options) {
    check_options(options);
    check_mesh("untangle", Vertices::Zero(cloth_n, 3), cloth_F, "cloth_V", "cloth_F");
    check_mesh("untangle", Vertices::Zero(body_n, 3), body_F, "body_V", "body_F");
    Adjacency ring = vertex_neighbours(cloth_F, cloth_n);
    Membrane membrane(ring);
    std::vector<int> to_rim = steps_to_rim(cloth_F, ring);
    state_ = std::make_unique<State>(State{std::move(cloth_F), cloth_n, body_n, options, std::move(ring), std::move(to_rim), std::move(membrane),
                                           Obstacle(std::move(body_F), options.max_depth), {}, {}, {}});
}

UntangleSolver::~UntangleSolver() = default;
UntangleSolver::UntangleSolver(UntangleSolver&&) noexcept = default;
UntangleSolver& UntangleSolver::operator=(UntangleSolver&&) noexcept = default;

namespace {

std::string reason_left(const UntangleResult& r, const Frame& frame) {
    int overlap = 0, tight = 0;
    for (Eigen::Index i = 0; i < frame.x.rows(); ++i) {
        const Probe& p = frame.at(i);
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
    s.body.move(body_V);
    if (!s.cloth_tree) {
        s.cloth_tree.emplace(cloth_V, s.cloth_F);
        s.tour = tour_of(*s.cloth_tree, s.cloth_F, s.cloth_n);
    }
    Frame frame(cloth_V, s.cloth_F, o, s.body, *s.cloth_tree, s.tour);
    const double stiffness = std::clamp(1.5 * std::pow(mean_edge(cloth_V, s.ring) / o.spread, 2), 1e-8, 1e8);

    UntangleResult r;
    frame.probe_all(s.faces_below);
    s.faces_below.resize(frame.probes.size());
    for (std::size_t i = 0; i < frame.probes.size(); ++i) s.faces_below[i] = frame.probes[i].face;
    frame.find_pairs();
    frame.decide_sides();
    r.depth_before = frame.depth();
    r.intersections_before = static_cast<int>(frame.pairs.rows());
    int fewest = std::numeric_limits<int>::max();
    Vertices best, d = Vertices::Zero(s.cloth_n, 3);
    for (int idle = 0, former = std::numeric_limits<int>::max();; ++r.iterations) {
        int violations = frame.violations();
        const bool see_pairs = 2 * violations >= former || 200 * violations < s.cloth_n;  // few left, or stubborn ones
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
            if (frame.carry_over(s.to_rim))
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
        frame.x = best.size() > 0 ? best : frame.x;
        frame.probe_near();
        frame.find_pairs();
        frame.decide_sides();
    }
    r.pairs_left = frame.pairs;
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
