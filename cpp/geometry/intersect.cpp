#include "geometry/intersect.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/intersections.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <variant>
#include <vector>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Segment = Kernel::Segment_3;
using Triangle = Kernel::Triangle_3;
using Simplex = std::variant<Point, Segment, Triangle>;

Point to_point(const Vec3& p) { return {p[0], p[1], p[2]}; }

/// The convex hull of three points: CGAL's triangle tests assume that a triangle has area.
Simplex hull(const Vec3& a, const Vec3& b, const Vec3& c) {
    Point p[3] = {to_point(a), to_point(b), to_point(c)};
    if (!CGAL::collinear(p[0], p[1], p[2])) return Triangle(p[0], p[1], p[2]);
    std::sort(p, p + 3);  // lexicographic: the ends of a collinear triple come first and last
    if (p[0] == p[2]) return p[0];
    return Segment(p[0], p[2]);
}

bool meet(const Point& p, const Point& q) { return p == q; }
bool meet(const Point& p, const Segment& s) { return s.has_on(p); }
bool meet(const Segment& s, const Point& p) { return s.has_on(p); }
bool meet(const Point& p, const Triangle& t) { return t.has_on(p); }
bool meet(const Triangle& t, const Point& p) { return t.has_on(p); }
template <class A, class B>
bool meet(const A& a, const B& b) {
    return CGAL::do_intersect(a, b);
}

bool meet_any(const Simplex& a, const Simplex& b) {
    return std::visit([](const auto& x, const auto& y) { return meet(x, y); }, a, b);
}

/// +1 or -1 where p certainly lies on that side of the plane through a, b, c; 0 where rounding leaves it open.
/// The bound is that of the plain determinant (Shewchuk 1997, section 4.3), with room for the underflow of tiny meshes.
int certain_side(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& p) {
    const Vec3 u = a - p, v = b - p, w = c - p;
    const double vw_x = v[1] * w[2], wv_x = v[2] * w[1], vw_y = v[2] * w[0], wv_y = v[0] * w[2];
    const double vw_z = v[0] * w[1], wv_z = v[1] * w[0];
    const double det = u[0] * (vw_x - wv_x) + u[1] * (vw_y - wv_y) + u[2] * (vw_z - wv_z);
    const double size = std::abs(u[0]) * (std::abs(vw_x) + std::abs(wv_x)) +
                        std::abs(u[1]) * (std::abs(vw_y) + std::abs(wv_y)) +
                        std::abs(u[2]) * (std::abs(vw_z) + std::abs(wv_z));
    const double bound = 8e-16 * size + 1e-250;
    return det > bound ? 1 : det < -bound ? -1 : 0;
}

/// The certain sides of a triangle's corners towards the plane of another, as `certain_side` counts them; the bound is
/// that of a plain normal and dot product.
struct Sides {
    int of[3];
    Sides(const BoxTree::Triangle& plane, const BoxTree::Triangle& t) {
        const Vec3 u = plane.b - plane.a, v = plane.c - plane.a, n = u.cross(v);
        const Vec3 size(std::abs(u[1] * v[2]) + std::abs(u[2] * v[1]), std::abs(u[2] * v[0]) + std::abs(u[0] * v[2]),
                        std::abs(u[0] * v[1]) + std::abs(u[1] * v[0]));
        const Vec3 corner[3] = {t.a - plane.a, t.b - plane.a, t.c - plane.a};
        for (int k = 0; k < 3; ++k) {
            const double height = n.dot(corner[k]), bound = 1.2e-15 * size.dot(corner[k].cwiseAbs()) + 1e-250;
            of[k] = height > bound ? -1 : height < -bound ? 1 : 0;
        }
    }
    bool one() const { return of[0] != 0 && of[0] == of[1] && of[0] == of[2]; }
};

/// +1: an edge of t certainly passes through the inside of s. -1: the section of t with the plane of s certainly lies
/// beyond one edge of s. 0: left open. `sides` are those of t's corners towards s.
int certain_crossing(const BoxTree::Triangle& s, const BoxTree::Triangle& t, const Sides& sides) {
    const Vec3* corner[3] = {&t.a, &t.b, &t.c};
    for (int k = 0; k < 3; ++k) {
        const int side = sides.of[k];
        if (side == 0 || sides.of[(k + 1) % 3] != -side || sides.of[(k + 2) % 3] != -side) continue;
        // The corner k lies alone on its side: its two edges cross the plane, and pass within an edge of s on turn -side.
        const Vec3 &p = *corner[k], &q = *corner[(k + 1) % 3], &r = *corner[(k + 2) % 3];
        int within_q = 0, within_r = 0;
        for (const auto& [from, to] : {std::pair(&s.a, &s.b), std::pair(&s.b, &s.c), std::pair(&s.c, &s.a)}) {
            const int turn_q = certain_side(p, q, *from, *to), turn_r = certain_side(p, r, *from, *to);
            if (turn_q == side && turn_r == side) return -1;
            within_q += turn_q == -side;
            within_r += turn_r == -side;
        }
        return within_q == 3 || within_r == 3 ? 1 : 0;
    }
    return 0;
}

/// Nearly all pairs are decided by signs that rounding cannot touch; the rest exactly.
bool meet_exactly(const BoxTree::Triangle& s, const BoxTree::Triangle& t) {
    const Sides of_t(s, t);
    if (of_t.one()) return false;
    const Sides of_s(t, s);
    if (of_s.one()) return false;
    if (const int crossing = certain_crossing(s, t, of_t)) return crossing > 0;
    if (const int crossing = certain_crossing(t, s, of_s)) return crossing > 0;
    return meet_any(hull(s.a, s.b, s.c), hull(t.a, t.b, t.c));
}

using Pair = std::array<int, 2>;

/// Walks two trees at once; `visit(i, j)` is called for slots whose boxes meet.
template <class Visit>
void walk(const BoxTree& first, int a, const BoxTree& second, int b, Visit&& visit) {
    const BoxTree::Node &na = first.nodes()[static_cast<std::size_t>(a)],
                        &nb = second.nodes()[static_cast<std::size_t>(b)];
    if (!na.box.intersects(nb.box)) return;
    if (na.leaf() && nb.leaf()) {
        for (int i = na.begin; i < na.end; ++i)
            if (first.box(i).intersects(nb.box))
                for (int j = nb.begin; j < nb.end; ++j)
                    if (first.box(i).intersects(second.box(j))) visit(i, j);
    } else if (nb.leaf() || (!na.leaf() && na.size() >= nb.size())) {
        walk(first, a + 1, second, b, visit);
        walk(first, na.right, second, b, visit);
    } else {
        walk(first, a, second, b + 1, visit);
        walk(first, a, second, nb.right, visit);
    }
}

/// Subtrees of at most `size` faces that cover the tree.
std::vector<int> subtrees(const BoxTree& tree, int size) {
    std::vector<int> roots;
    const int count = static_cast<int>(tree.nodes().size());
    for (int k = 0; k < count;) {
        const BoxTree::Node& node = tree.nodes()[static_cast<std::size_t>(k)];
        if (node.leaf() || node.size() <= size) {
            roots.push_back(k);
            for (++k; k < count && tree.nodes()[static_cast<std::size_t>(k)].begin < node.end;) ++k;
        } else {
            ++k;
        }
    }
    return roots;
}

/// Pairs (f, g) of faces for which `meet(f, slot of f, g, slot of g)`, sorted.
template <class Meet>
Edges collect(const BoxTree& first, const BoxTree& second, Meet&& meet) {
    const std::vector<int> roots = subtrees(first, 256);
    std::vector<std::vector<Pair>> found(roots.size());
    parallel_for(static_cast<std::int64_t>(roots.size()), [&](std::int64_t k) {
        auto& mine = found[static_cast<std::size_t>(k)];
        walk(first, roots[static_cast<std::size_t>(k)], second, 0, [&](int i, int j) {
            const int f = first.order()[static_cast<std::size_t>(i)], g = second.order()[static_cast<std::size_t>(j)];
            if (meet(f, i, g, j)) mine.push_back({f, g});
        });
    }, 1);
    std::vector<Pair> all;
    for (const auto& some : found) all.insert(all.end(), some.begin(), some.end());
    std::sort(all.begin(), all.end());
    Edges pairs(static_cast<Eigen::Index>(all.size()), 2);
    for (std::size_t k = 0; k < all.size(); ++k) pairs.row(static_cast<Eigen::Index>(k)) << all[k][0], all[k][1];
    return pairs;
}

bool share_vertex(const Faces& F, int f, int g) {
    for (int c = 0; c < 3; ++c)
        if ((F.row(g).array() == F(f, c)).any()) return true;
    return false;
}

}  // namespace

bool triangles_intersect(const Vec3& a0, const Vec3& a1, const Vec3& a2, const Vec3& b0, const Vec3& b1,
                         const Vec3& b2) {
    return meet_exactly({a0, a1, a2}, {b0, b1, b2});
}

Edges meeting_faces(const BoxTree& first, const BoxTree& second) {
    return collect(first, second,
                   [&](int, int i, int, int j) { return meet_exactly(first.triangle(i), second.triangle(j)); });
}

Edges intersecting_pairs(const Vertices& V1, const Faces& F1, const Vertices& V2, const Faces& F2) {
    check_mesh("intersecting_pairs", V1, F1, "V1", "F1");
    check_mesh("intersecting_pairs", V2, F2, "V2", "F2");
    return meeting_faces(BoxTree(V1, F1), BoxTree(V2, F2));
}

Edges self_intersections(const Vertices& V, const Faces& F) {
    check_mesh("self_intersections", V, F);
    const BoxTree tree(V, F);
    return collect(tree, tree, [&](int f, int i, int g, int j) {
        return f < g && !share_vertex(F, f, g) && meet_exactly(tree.triangle(i), tree.triangle(j));
    });
}

}  // namespace toile
