#include "geometry/intersect.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/intersections.h>

#include <algorithm>
#include <variant>

#include "base/errors.h"
#include "base/parallel.h"
#include "geometry/box_tree.h"

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

std::vector<Simplex> hulls(const Vertices& V, const Faces& F) {
    std::vector<Simplex> out(static_cast<std::size_t>(F.rows()), Point());
    parallel_for(F.rows(), [&](std::int64_t f) {
        out[static_cast<std::size_t>(f)] = hull(V.row(F(f, 0)), V.row(F(f, 1)), V.row(F(f, 2)));
    });
    return out;
}

/// Per face of the first mesh the sorted partners of the second, laid end to end.
template <class Search>
Edges collect(Eigen::Index faces, Search&& partners_of) {
    std::vector<std::vector<int>> partners(static_cast<std::size_t>(faces));
    parallel_for(
        faces,
        [&](std::int64_t f) {
            auto& mine = partners[static_cast<std::size_t>(f)];
            partners_of(static_cast<int>(f), mine);
            std::sort(mine.begin(), mine.end());
        },
        64);
    Eigen::Index count = 0;
    for (const auto& p : partners) count += static_cast<Eigen::Index>(p.size());
    Edges pairs(count, 2);
    Eigen::Index row = 0;
    for (std::size_t f = 0; f < partners.size(); ++f)
        for (int g : partners[f]) pairs.row(row++) << static_cast<int>(f), g;
    return pairs;
}

bool share_vertex(const Faces& F, int f, int g) {
    for (int c = 0; c < 3; ++c)
        if ((F.row(g).array() == F(f, c)).any()) return true;
    return false;
}

}  // namespace

bool triangles_intersect(const Vec3& a0, const Vec3& a1, const Vec3& a2, const Vec3& b0, const Vec3& b1, const Vec3& b2) {
    return meet_any(hull(a0, a1, a2), hull(b0, b1, b2));
}

struct TriangleIndex::State {
    Faces F;
    BoxTree tree;
    std::vector<Simplex> faces;
};

TriangleIndex::TriangleIndex(const Vertices& V, const Faces& F)
    : state_(std::make_unique<State>(State{F, BoxTree(V, F), hulls(V, F)})) {}
TriangleIndex::~TriangleIndex() = default;
TriangleIndex::TriangleIndex(TriangleIndex&&) noexcept = default;
TriangleIndex& TriangleIndex::operator=(TriangleIndex&&) noexcept = default;

Edges TriangleIndex::pairs(const Vertices& V1, const Faces& F1) const {
    const State& s = *state_;
    return collect(F1.rows(), [&](int f, std::vector<int>& partners) {
        s.tree.overlapping(face_box(V1, F1, f), partners);
        if (partners.empty()) return;
        const Simplex mine = hull(V1.row(F1(f, 0)), V1.row(F1(f, 1)), V1.row(F1(f, 2)));
        std::erase_if(partners, [&](int g) { return !meet_any(mine, s.faces[static_cast<std::size_t>(g)]); });
    });
}

Edges TriangleIndex::self_pairs() const {
    const State& s = *state_;
    return collect(s.F.rows(), [&](int f, std::vector<int>& partners) {
        s.tree.overlapping(s.tree.face_box(f), partners);
        std::erase_if(partners, [&](int g) {
            return g <= f || share_vertex(s.F, f, g) ||
                   !meet_any(s.faces[static_cast<std::size_t>(f)], s.faces[static_cast<std::size_t>(g)]);
        });
    });
}

Edges intersecting_pairs(const Vertices& V1, const Faces& F1, const Vertices& V2, const Faces& F2) {
    check_mesh("intersecting_pairs", V1, F1, "V1", "F1");
    check_mesh("intersecting_pairs", V2, F2, "V2", "F2");
    return TriangleIndex(V2, F2).pairs(V1, F1);
}

Edges self_intersections(const Vertices& V, const Faces& F) {
    check_mesh("self_intersections", V, F);
    return TriangleIndex(V, F).self_pairs();
}

}  // namespace toile
