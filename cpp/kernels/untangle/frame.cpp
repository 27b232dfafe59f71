// One frame of `untangle`.
#include "kernels/untangle/frame.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "base/parallel.h"
#include "geometry/intersect.h"

namespace toile {

namespace {

constexpr int carries_allowed = 20;    // of a vertex, so that none goes to and fro
constexpr int shortfalls_allowed = 4;  // of a vertex that is outside
constexpr double least_margin = 0.01;  // of the margin, between parts that leave no room
constexpr double watched = 2;          // margins: vertices nearer than this are kept from the body

/// Where edge pq crosses the triangle; false if it does not. Plain arithmetic: only pushes depend on it.
bool crossing(const Vec3& p, const Vec3& q, const BoxTree::Triangle& t, Vec3& x) {
    const auto& [a, b, c] = t;
    const Vec3 n = (b - a).cross(c - a);
    const double s = n.dot(p - a), e = n.dot(q - a);
    if (s * e > 0 || s == e) return false;
    x = p + (q - p) * (s / (s - e));
    return n.dot((b - a).cross(x - a)) >= 0 && n.dot((c - b).cross(x - b)) >= 0 && n.dot((a - c).cross(x - c)) >= 0;
}

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

/// Edges from each vertex to the nearest border; the largest int where the cloth has none.
std::vector<int> steps_to_border(const Faces& F, const Adjacency& ring) {
    const std::vector<char> border = border_vertices(F, ring.size());
    std::vector<int> steps(border.size(), std::numeric_limits<int>::max()), queue;
    for (int v = 0; v < ring.size(); ++v)
        if (border[static_cast<std::size_t>(v)]) steps[static_cast<std::size_t>(v)] = 0, queue.push_back(v);
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
class Groups {
public:
    explicit Groups(Eigen::Index n) : parent_(static_cast<std::size_t>(n)) {
        std::iota(parent_.begin(), parent_.end(), 0);
    }
    int of(int v) {
        int root = v;
        while (parent_[static_cast<std::size_t>(root)] != root) root = parent_[static_cast<std::size_t>(root)];
        while (parent_[static_cast<std::size_t>(v)] != root)
            v = std::exchange(parent_[static_cast<std::size_t>(v)], root);
        return root;
    }
    void join(int v, int w) {
        v = of(v), w = of(w);
        parent_[static_cast<std::size_t>(std::max(v, w))] = std::min(v, w);
    }

private:
    std::vector<int> parent_;
};

}  // namespace

Cloth::Cloth(Faces faces, Eigen::Index n) : F(std::move(faces)), ring(vertex_neighbours(F, n)) {}

const std::vector<int>& Cloth::to_border() {
    if (to_border_.empty()) to_border_ = steps_to_border(F, ring);
    return to_border_;
}

void Cloth::fit_tree(const Vertices& V) {
    if (tree) return;
    tree = std::make_unique<BoxTree>(V, F);
    tour = tour_of(*tree, F, V.rows());
}

UntangleFrame::UntangleFrame(const Vertices& cloth_V, Cloth& cloth, const Obstacle& body,
                             const UntangleOptions& options)
    : x(cloth_V), margin(Vector::Constant(cloth_V.rows(), options.margin)), start_(cloth_V), cloth_(cloth), F_(cloth.F),
      body_(body), options_(options), probed_at_(cloth_V), pushes_(Vertices::Zero(cloth_V.rows(), 3)) {
    const auto n = static_cast<std::size_t>(cloth_V.rows());
    probes_.resize(n);
    given_up_.resize(n);
    turned_.resize(static_cast<std::size_t>(body.faces()));
    was_violated_.resize(n);
    carried_.resize(n);
    carries_.resize(n);
    shortfalls_.resize(n);
    planes.resize(n);
    creases_.resize(n);
    lifts_.resize(n);
    cloth_.fit_tree(cloth_V);
    const Box& box = body.tree().nodes()[0].box;
    rounding_ = 1e-9 * box.diagonal().norm() + 1e-12 * box.min().cwiseAbs().cwiseMax(box.max().cwiseAbs()).maxCoeff();
}

void UntangleFrame::probe_all(const std::vector<int>& guesses) {
    constexpr Eigen::Index block = 64;
    parallel_for((x.rows() + block - 1) / block, [&](std::int64_t b) {
        int guess = -1;  // without a better one, the face of the vertex before
        for (Eigen::Index k = b * block; k < std::min(x.rows(), (b + 1) * block); ++k) {
            const int i = cloth_.tour[static_cast<std::size_t>(k)];
            at(i) = body_.probe(x.row(i), guesses.empty() ? guess : guesses[static_cast<std::size_t>(i)]);
            guess = at(i).face;
        }
    }, 1);
}

/// Free distance that vertex i is sure of where it is now, in spite of rounding [m].
double UntangleFrame::sure_distance(Eigen::Index i) const {
    return at(i).nearest - (x.row(i) - probed_at_.row(i)).norm() - rounding_;
}

bool UntangleFrame::known_clear(Eigen::Index i) const {
    return !at(i).inside() && sure_distance(i) > watched * options_.margin;
}

void UntangleFrame::probe_near() {
    parallel_for(x.rows(), [&](std::int64_t k) {
        const int i = cloth_.tour[static_cast<std::size_t>(k)];
        if (known_clear(i)) return;
        at(i) = body_.probe(x.row(i), at(i).face);
        if (at(i).face >= 0 && turned_[static_cast<std::size_t>(at(i).face)]) at(i).turn();
        probed_at_.row(i) = x.row(i);
        if (given_up_[static_cast<std::size_t>(i)]) at(i).constrained = false;
        shrink_margin(i);
    }, 64);
}

/// Where a vertex that was pushed off one part now stands too near to another that faces it, the two meet in the middle:
/// it was `margin` from the first plane, so half of both distances is half the room. In the corner of a crease, where no
/// pair is left to mend and push after push falls short, the margin is what was reached.
void UntangleFrame::shrink_margin(Eigen::Index i) {
    const HalfSpaces& last = planes[static_cast<std::size_t>(i)];
    const Probe& p = at(i);
    if (!violated(i) || last.count == 0) return;
    const double least = least_margin * options_.margin;
    if (last.normal[0].dot(p.outward) < 0 && p.distance > -1.1 * margin[i])
        margin[i] = std::max(0.5 * (margin[i] + p.distance), least);
    else if (pairs.rows() == 0 && p.distance > 0 && ++shortfalls_[static_cast<std::size_t>(i)] > shortfalls_allowed)
        margin[i] = std::max(p.distance, least);
}

/// A face is left out when balls at its corners that hold nothing of the body cover it: every point of a triangle lies
/// within longest edge / sqrt(3) of a corner.
void UntangleFrame::find_pairs() {
    std::vector<char> hidden(static_cast<std::size_t>(F_.rows()));
    parallel_for(F_.rows(), [&](std::int64_t f) {
        double free = std::numeric_limits<double>::infinity(), longest = 0;
        for (int c = 0; c < 3; ++c) {
            free = std::min(free, sure_distance(F_(f, c)));
            longest = std::max(longest, (x.row(F_(f, c)) - x.row(F_(f, (c + 1) % 3))).norm());
        }
        hidden[static_cast<std::size_t>(f)] = free > 0.578 * longest;
    });
    cloth_.tree->refit(x, F_, hidden);
    pairs = meeting_faces(*cloth_.tree, body_.tree());
}

/// By the winding number. It is constant along faces that do not meet the body, and along edges covered by balls that
/// hold nothing of it; so one look serves a whole group of vertices.
void UntangleFrame::decide_sides() {
    if (!body_.closed()) return;
    std::vector<char> pierced(static_cast<std::size_t>(F_.rows()), 0);
    for (Eigen::Index k = 0; k < pairs.rows(); ++k) pierced[static_cast<std::size_t>(pairs(k, 0))] = 1;
    Groups groups(x.rows());
    for (Eigen::Index f = 0; f < F_.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = F_(f, c), j = F_(f, (c + 1) % 3);
            const bool covered = !pierced[static_cast<std::size_t>(f)] ||
                                 (x.row(i) - x.row(j)).norm() < (1 - 1e-9) * (sure_distance(i) + sure_distance(j));
            if (covered) groups.join(i, j);
        }
    std::vector<int> speaker(probes_.size(), -1);  // the vertex of a group that is farthest from the body
    for (int i = 0; i < x.rows(); ++i) {
        int& s = speaker[static_cast<std::size_t>(groups.of(i))];
        if (s < 0 || at(i).nearest > at(s).nearest) s = i;
    }
    std::vector<int> parts(probes_.size(), 0);
    parallel_for(x.rows(), [&](std::int64_t i) {
        const int s = speaker[static_cast<std::size_t>(i)];
        if (s >= 0) parts[static_cast<std::size_t>(i)] = body_.parts(x.row(s));
    }, 64);
    for (int i = 0; i < x.rows(); ++i) {
        const int inside_of = parts[static_cast<std::size_t>(groups.of(i))];
        if (inside_of != 0 || !known_clear(i)) {
            const int turned = Obstacle::turned(at(i), inside_of);
            if (turned >= 0) turned_[static_cast<std::size_t>(at(i).face)] = turned != 0;
            body_.decide(at(i), inside_of);
        }
        const bool lost = at(i).inside() && !at(i).constrained;
        given_up_[static_cast<std::size_t>(i)] = lost && !body_.pass_through(x.row(i), at(i));
    }
}

/// The last of the pairs of one cloth face, from its first, plus one.
Eigen::Index UntangleFrame::last_of_face(Eigen::Index pair) const {
    Eigen::Index end = pair;
    while (end < pairs.rows() && pairs(end, 0) == pairs(pair, 0)) ++end;
    return end;
}

/// Does the body, where it meets the face of these pairs, cut its edge ij?
bool UntangleFrame::cut(int i, int j, Eigen::Index first_pair, Eigen::Index last_pair) const {
    Vec3 where;
    for (Eigen::Index k = first_pair; k < last_pair; ++k)
        if (crossing(x.row(i), x.row(j), body_.triangle(pairs(k, 1)), where)) return true;
    return false;
}

/// A limb that passes right through faces stands between their corners. The corners nearer to the cloth's border are carried
/// over to the side of the others, so that from step to step the hole travels to the border and off the cloth.
bool UntangleFrame::carry_over() {
    const auto rank = [&](int v) { return std::pair(cloth_.to_border()[static_cast<std::size_t>(v)], v); };
    bool any = false;
    for (Eigen::Index k = 0, end; k < pairs.rows(); k = end) {
        end = last_of_face(k);
        for (int c = 0; c < 3; ++c) {
            int i = F_(pairs(k, 0), c), j = F_(pairs(k, 0), (c + 1) % 3);
            if (at(i).outward.dot(at(j).outward) >= 0 || !cut(i, j, k, end)) continue;
            if (rank(j) < rank(i)) std::swap(i, j);
            const auto v = static_cast<std::size_t>(i);
            if (!carried_[v] && carries_[v]++ >= carries_allowed) continue;
            carried_[v] = 1;
            const Probe& there = at(j);
            planes[v] =
                HalfSpaces::one(there.outward, there.outward.dot(there.point - start_.row(i).transpose()) + margin[j]);
            lifts_[v] = {};
            pushes_.row(i).setZero();
            any = true;
        }
    }
    return any;
}

/// The plane at the closest point for every vertex near the body, and what creases and pierced faces ask for.
void UntangleFrame::renew_planes() {
    parallel_for(x.rows(), [&](std::int64_t i) {
        const auto k = static_cast<std::size_t>(i);
        if (std::exchange(carried_[k], 0)) return;
        const HalfSpaces last = std::exchange(planes[k], {});
        const Probe& p = at(i);
        if (pairs.rows() > 0) creases_[k] = {};
        if (violated(i)) {
            // Still outside, but pushed off one side too near to another: a crease, kept from both sides.
            const bool crease = pairs.rows() == 0 && was_violated_[k] && last.count > 0 && !p.inside();
            if (crease) creases_[k] = HalfSpaces::one(last.normal[0], last.least[0]);
            was_violated_[k] = 1;
        }
        if (p.constrained && (was_violated_[k] || p.distance < watched * options_.margin))
            planes[k].add(p.outward, p.outward.dot(p.point - start_.row(i).transpose()) + margin[i]);
        const HalfSpaces& second = lifts_[k].count > 0 ? lifts_[k] : creases_[k];
        if (second.count > 0) planes[k].add(second.normal[0], second.least[0]);
    });
}

/// The middle of the curve along which the cloth face of these pairs meets the body.
Vec3 UntangleFrame::middle_of_section(Eigen::Index first_pair, Eigen::Index last_pair) const {
    const auto face = F_.row(pairs(first_pair, 0));
    const BoxTree::Triangle mine{x.row(face[0]), x.row(face[1]), x.row(face[2])};
    Vec3 sum = Vec3::Zero(), where;
    int count = 0;
    for (Eigen::Index k = first_pair; k < last_pair; ++k) {
        const BoxTree::Triangle& theirs = body_.triangle(pairs(k, 1));
        const auto add = [&](const Vec3& p, const Vec3& q, const BoxTree::Triangle& t) {
            if (crossing(p, q, t, where)) sum += where, ++count;
        };
        add(mine.a, mine.b, theirs), add(mine.b, mine.c, theirs), add(mine.c, mine.a, theirs);
        add(theirs.a, theirs.b, mine), add(theirs.b, theirs.c, mine), add(theirs.c, theirs.a, mine);
    }
    return count == 0 ? Vec3((mine.a + mine.b + mine.c) / 3) : Vec3(sum / count);
}

Probe UntangleFrame::probe_decided(const Vec3& p) const {
    Probe out = body_.probe(p);
    if (!body_.closed()) return out;
    body_.decide(out, body_.parts(p));
    if (out.inside() && !out.constrained) body_.pass_through(p, out);
    return out;
}

/// Corners of pierced faces are lifted out of the body so that the face clears the depth found in the section's middle.
/// At least by `least` [m]: a section that ends at the face's side has its middle near the surface and tells no depth.
void UntangleFrame::lift_pierced(double least) {
    Vector lifted = Vector::Zero(x.rows());
    Vertices push = Vertices::Zero(x.rows(), 3);
    for (Eigen::Index k = 0, end; k < pairs.rows(); k = end) {
        end = last_of_face(k);
        const auto face = F_.row(pairs(k, 0));
        const Vec3 middle = middle_of_section(k, end);
        const Probe p = probe_decided(middle);
        if (!p.constrained && p.nearest > 0.5 * options_.margin) continue;  // on the surface any side will do
        const Vec3 b = closest_on_triangle(middle, x.row(face[0]), x.row(face[1]), x.row(face[2])).barycentric;
        const double lift = std::max(0.0, -p.distance) + least;
        for (int c = 0; c < 3; ++c) {
            const double rise = lift * b[c] / b.squaredNorm();
            if (rise <= lifted[face[c]]) continue;
            lifted[face[c]] = rise;
            push.row(face[c]) = rise * p.outward;
        }
    }
    for (Eigen::Index i = 0; i < x.rows(); ++i) {
        if (lifted[i] == 0) continue;
        pushes_.row(i) += push.row(i);  // of two flanks of a ridge: up
        const Vec3 way = pushes_.row(i).transpose().normalized();
        const Vec3 goal = x.row(i) - start_.row(i) + push.row(i);
        lifts_[static_cast<std::size_t>(i)] = HalfSpaces::one(way, way.dot(goal));
    }
}

int UntangleFrame::violations() const {
    int count = 0;
    for (Eigen::Index i = 0; i < x.rows(); ++i) count += violated(i);
    return count;
}

int UntangleFrame::vertices_inside() const {
    return static_cast<int>(std::count_if(probes_.begin(), probes_.end(), [](const Probe& p) { return p.inside(); }));
}

Vector UntangleFrame::depth() const {
    Vector d(x.rows());
    for (Eigen::Index i = 0; i < d.size(); ++i) d[i] = std::max(0.0, -at(i).distance);
    return d;
}

std::vector<int> UntangleFrame::faces_below() const {
    std::vector<int> faces;
    for (const Probe& p : probes_) faces.push_back(p.face);
    return faces;
}

std::string UntangleFrame::reason_left() const {
    int overlap = 0, tight = 0;
    for (Eigen::Index i = 0; i < x.rows(); ++i) {
        if (at(i).inside() && !at(i).constrained) ++overlap;
        if (margin[i] < 0.25 * options_.margin) ++tight;
    }
    const auto text = [](auto count) { return std::to_string(count); };
    std::string why = text(vertices_inside()) + " vertices inside, " + text(pairs.rows()) + " pairs left";
    if (violations() > 0) why += "; " + text(violations()) + " vertices nearer than their margin";
    if (overlap > 0) why += "; " + text(overlap) + " vertices lie where the body overlaps itself";
    if (tight > 0)
        why += "; " + text(tight) + " vertices have less room than half the margin between two parts of the body";
    if (pairs.rows() > 0 && overlap == 0 && tight == 0)
        why += "; the body passes through the cloth further than pushes along its normals can mend";
    return why;
}

}  // namespace toile
