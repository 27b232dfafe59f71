#include "geometry/box_tree.h"

#include <algorithm>
#include <limits>

#include "base/parallel.h"

namespace toile {

namespace {

constexpr int leaf_size = 4;      // as many faces as a register has lanes
constexpr double tie = 1 + 2e-9;  // squares this near are equal: what symmetry makes equal, rounding must not decide

/// The smallest face among the nearest of those added, in whatever order they come.
class Nearest {
public:
    void add(double square, int face, int slot) {
        if (!(square <= limit())) return;
        least_ = std::min(least_, square);
        const auto end = candidates_ + count_;
        if (std::any_of(candidates_, end, [&](const Candidate& c) { return c.face <= face && c.square <= square; }))
            return;
        count_ = static_cast<int>(std::remove_if(candidates_, end, [&](const Candidate& c) {
            return c.square > limit() || (face <= c.face && square <= c.square);
        }) - candidates_);
        if (count_ < most) candidates_[count_++] = {square, face, slot};
    }
    double limit() const { return least_ * tie; }
    int slot() const {
        int first = -1;
        for (int k = 0; k < count_; ++k)
            if (candidates_[k].square <= limit() && (first < 0 || candidates_[k].face < candidates_[first].face))
                first = k;
        return first < 0 ? -1 : candidates_[first].slot;
    }

private:
    struct Candidate {
        double square;
        int face, slot;
    };
    static constexpr int most = 16;  // of a handful: each is nearer than all of smaller faces
    Candidate candidates_[most];
    int count_ = 0;
    double least_ = std::numeric_limits<double>::infinity();
};

}  // namespace

Box face_box(const Vertices& V, const Faces& F, Eigen::Index face) {
    Box box(Vec3(V.row(F(face, 0))));
    box.extend(Vec3(V.row(F(face, 1))));
    box.extend(Vec3(V.row(F(face, 2))));
    return box;
}

/// Nodes of a tree over so many faces, and its leaves: fixed by the number alone, so subtrees can be built side by side.
/// At the first depth with parts of `leaf_size` at most some still have one face more; these are halved once again.
BoxTree::Count BoxTree::count(int faces) {
    int depth = 0;
    while (faces >> depth > leaf_size) ++depth;
    const int parts = 1 << depth, larger = faces >> depth == leaf_size ? faces - (leaf_size << depth) : 0;
    return {2 * (parts + larger) - 1, parts + larger};
}

BoxTree::BoxTree(const Vertices& V, const Faces& F) {
    const auto m = static_cast<std::size_t>(F.rows());
    if (m == 0) return;
    const Count all = count(static_cast<int>(m));
    nodes_.resize(static_cast<std::size_t>(all.nodes));
    packs_.resize(static_cast<std::size_t>(all.leaves));
    order_.resize(m);
    slot_.resize(m);
    leaf_.resize(m);
    triangles_.resize(m);
    boxes_.resize(m);
    const Vec3 origin = V.row(F(0, 0));
    std::vector<Centre> centres(m);
    parallel_for(F.rows(), [&](std::int64_t f) {
        const Vec3 place = toile::face_box(V, F, f).center() - origin;
        centres[static_cast<std::size_t>(f)] = {{float(place[0]), float(place[1]), float(place[2])},
                                                static_cast<int>(f)};
    });
    std::vector<Part> parts{{0, 0, static_cast<int>(m), 0}};
    while (parts[0].end - parts[0].begin > 2048) {  // all parts are of one size, give or take a face
        const std::size_t n = parts.size();
        parts.resize(2 * n);
        parallel_for(static_cast<std::int64_t>(n), [&](std::int64_t k) {
            parts[n + static_cast<std::size_t>(k)] = halve(parts[static_cast<std::size_t>(k)], centres);
        }, 1);
    }
    parallel_for(static_cast<std::int64_t>(parts.size()),
                 [&](std::int64_t k) { build(parts[static_cast<std::size_t>(k)], centres); }, 1);
    for (std::size_t k = 0; k < m; ++k) slot_[static_cast<std::size_t>(order_[k])] = static_cast<int>(k);
    widen();
    refit(V, F);
}

/// Makes the part's node an inner one; the part becomes the left half, and the right one is returned.
BoxTree::Part BoxTree::halve(Part& part, std::vector<Centre>& centres) {
    const auto [node, begin, end, leaf] = part;
    Eigen::AlignedBox3f box;
    for (int k = begin; k < end; ++k)
        box.extend(Eigen::Map<const Eigen::Vector3f>(centres[static_cast<std::size_t>(k)].place));
    int axis = 0;
    box.sizes().maxCoeff(&axis);
    const int middle = begin + (end - begin) / 2;
    const auto before = [axis](const Centre& a, const Centre& b) {
        return a.place[axis] < b.place[axis] || (a.place[axis] == b.place[axis] && a.face < b.face);
    };
    std::nth_element(centres.begin() + begin, centres.begin() + middle, centres.begin() + end, before);
    const Count left = count(middle - begin);
    const int right = node + 1 + left.nodes;
    nodes_[static_cast<std::size_t>(node)] = {Box(), begin, end, right, -1};
    part = {node + 1, begin, middle, leaf};
    return {right, middle, end, leaf + left.leaves};
}

void BoxTree::build(Part part, std::vector<Centre>& centres) {
    while (part.end - part.begin > leaf_size) build(halve(part, centres), centres);
    nodes_[static_cast<std::size_t>(part.node)] = {Box(), part.begin, part.end, -1 - part.leaf, -1};
    for (int k = part.begin; k < part.end; ++k) {
        const int f = order_[static_cast<std::size_t>(k)] = centres[static_cast<std::size_t>(k)].face;
        leaf_[static_cast<std::size_t>(f)] = part.node;
    }
}

/// Every second level of inner nodes, from the root on.
void BoxTree::widen() {
    std::vector<int> ahead;
    if (!nodes_.empty() && !nodes_[0].leaf()) ahead.push_back(0);
    while (!ahead.empty()) {
        const int self = ahead.back();
        ahead.pop_back();
        nodes_[static_cast<std::size_t>(self)].wide = static_cast<int>(wide_.size());
        Wide wide{{}, {}, {-1, -1, -1, -1}};
        int count = 0;
        for (int child : {self + 1, nodes_[static_cast<std::size_t>(self)].right}) {
            const Node& node = nodes_[static_cast<std::size_t>(child)];
            if (node.leaf()) {
                wide.child[count++] = child;
                continue;
            }
            for (int grandchild : {child + 1, node.right}) wide.child[count++] = grandchild;
        }
        for (int k = 0; k < count; ++k)
            if (!nodes_[static_cast<std::size_t>(wide.child[k])].leaf()) ahead.push_back(wide.child[k]);
        wide_.push_back(wide);
    }
}

void BoxTree::refit(const Vertices& V, const Faces& F, const std::vector<char>& hidden) {
    parallel_for(static_cast<std::int64_t>(nodes_.size()), [&](std::int64_t self) {
        Node& node = nodes_[static_cast<std::size_t>(self)];
        if (!node.leaf()) return;
        Pack& pack = packs_[static_cast<std::size_t>(-1 - node.right)];
        node.box.setEmpty();
        for (int lane = 0; lane < leaf_size; ++lane) {
            const auto slot = static_cast<std::size_t>(std::min(node.begin + lane, node.end - 1));
            const int f = order_[slot];
            const Triangle& t = triangles_[slot] = {V.row(F(f, 0)), V.row(F(f, 1)), V.row(F(f, 2))};
            for (int k = 0; k < 3; ++k) pack.a[k][lane] = t.a[k], pack.b[k][lane] = t.b[k], pack.c[k][lane] = t.c[k];
            boxes_[slot].setEmpty();
            if (hidden.empty() || !hidden[static_cast<std::size_t>(f)])
                boxes_[slot].extend(t.a).extend(t.b).extend(t.c);
            node.box.extend(boxes_[slot]);
        }
    });
    for (std::size_t self = nodes_.size(); self-- > 0;)
        if (Node& node = nodes_[self]; !node.leaf())
            node.box = nodes_[self + 1].box.merged(nodes_[static_cast<std::size_t>(node.right)].box);
    parallel_for(static_cast<std::int64_t>(wide_.size()), [&](std::int64_t k) {
        Wide& wide = wide_[static_cast<std::size_t>(k)];
        for (int lane = 0; lane < 4; ++lane) {
            const Box box = wide.child[lane] < 0 ? Box() : nodes_[static_cast<std::size_t>(wide.child[lane])].box;
            for (int axis = 0; axis < 3; ++axis) {
                const bool none = box.isEmpty();
                wide.low[axis][lane] = none ? std::numeric_limits<double>::infinity() : box.min()[axis];
                wide.high[axis][lane] = none ? -std::numeric_limits<double>::infinity() : box.max()[axis];
            }
        }
    });
}

BoxTree::Lanes BoxTree::squared_distances(const Wide& node, const Vec3& p) {
    Lanes sum{};
    for (int axis = 0; axis < 3; ++axis) {
        const Lanes low = node.low[axis] - p[axis], high = p[axis] - node.high[axis];
        const Lanes outside = low > high ? low : high;
        const Lanes gap = outside > 0 ? outside : Lanes{};
        sum += gap * gap;
    }
    return sum;
}

/// Of p to each face: the distance to the plane where p projects into the face, else to the nearest edge. Faces that are
/// all but segments (height below 1e-9 of the length) have edges only.
BoxTree::Lanes BoxTree::squared_distances(const Pack& t, const Vec3& p) {
    struct Vector {
        Lanes x, y, z;
        Vector operator-(const Vector& o) const { return {x - o.x, y - o.y, z - o.z}; }
        Lanes dot(const Vector& o) const { return x * o.x + y * o.y + z * o.z; }
        Vector cross(const Vector& o) const { return {y * o.z - z * o.y, z * o.x - x * o.z, x * o.y - y * o.x}; }
    };
    const Lanes zero{}, one = zero + 1, tiny = zero + 1e-300;
    const auto smaller = [](const Lanes& u, const Lanes& v) { return u < v ? u : v; };
    const auto larger = [](const Lanes& u, const Lanes& v) { return u > v ? u : v; };
    // Relative to p: no digits are lost far from the origin.
    const Vector a{t.a[0] - p[0], t.a[1] - p[1], t.a[2] - p[2]}, b{t.b[0] - p[0], t.b[1] - p[1], t.b[2] - p[2]},
        c{t.c[0] - p[0], t.c[1] - p[1], t.c[2] - p[2]}, ab = b - a, bc = c - b, ca = a - c, n = ab.cross(bc);
    const auto to_edge = [&](const Vector& from, const Vector& edge) {
        const Lanes s = smaller(larger(-from.dot(edge) / larger(edge.dot(edge), tiny), zero), one);
        const Vector q{from.x + s * edge.x, from.y + s * edge.y, from.z + s * edge.z};
        return q.dot(q);
    };
    const auto within = [&](const Vector& from, const Vector& edge) { return n.cross(edge).dot(from) <= zero; };
    const Lanes edges = smaller(smaller(to_edge(a, ab), to_edge(b, bc)), to_edge(c, ca));
    const Lanes height = n.dot(a), square = n.dot(n), length = larger(ab.dot(ab), bc.dot(bc));
    const auto inside =
        within(a, ab) & within(b, bc) & within(c, ca) & (square > 1e-18 * length * length) & (square > tiny);
    return inside ? height * height / square : edges;
}

SurfacePoint BoxTree::closest(const Vec3& p, int guess) const {
    struct Ahead {
        int node;
        double square;
    } stack[stack_size];
    int top = 0;
    Nearest nearest;
    const auto visit = [&](const Node& leaf) {
        const Lanes squares = squared_distances(packs_[static_cast<std::size_t>(-1 - leaf.right)], p);
        for (int k = leaf.begin; k < leaf.end; ++k)
            nearest.add(squares[k - leaf.begin], order_[static_cast<std::size_t>(k)], k);
    };
    if (guess >= 0) visit(nodes_[static_cast<std::size_t>(leaf_[static_cast<std::size_t>(guess)])]);
    if (!nodes_.empty()) stack[top++] = {0, 0};
    while (top > 0) {
        const auto [self, box_square] = stack[--top];
        if (box_square > nearest.limit()) continue;
        const Node& node = nodes_[static_cast<std::size_t>(self)];
        if (node.leaf()) {
            visit(node);
            continue;
        }
        const Wide& wide = wide_[static_cast<std::size_t>(node.wide)];
        const Lanes squares = squared_distances(wide, p);
        const int bottom = top;
        for (int lane = 0; lane < 4; ++lane) {  // the nearest on top
            if (!(squares[lane] <= nearest.limit()) || wide.child[lane] < 0) continue;
            int k = top++;
            for (; k > bottom && stack[k - 1].square < squares[lane]; --k) stack[k] = stack[k - 1];
            stack[k] = {wide.child[lane], squares[lane]};
        }
    }
    const int slot = nearest.slot();
    SurfacePoint out;
    if (slot < 0) return out;
    const Triangle& t = triangle(slot);
    out = closest_on_triangle(Vec3::Zero(), t.a - p, t.b - p, t.c - p);
    out.distance = out.point.norm();
    out.point += p;
    out.face = order_[static_cast<std::size_t>(slot)];
    return out;
}

}  // namespace toile
