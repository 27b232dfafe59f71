#include "geometry/intersect.h"

#include <cmath>

#include "base/errors.h"
#include "check.h"
#include "geometry/winding.h"

using namespace toile;

namespace {

/// The cube [0,1]^3 with outward faces, moved by `shift`.
void cube(const Vec3& shift, Vertices& V, Faces& F) {
    V.resize(8, 3);
    for (int i = 0; i < 8; ++i) V.row(i) << (i & 1) + shift[0], ((i >> 1) & 1) + shift[1], ((i >> 2) & 1) + shift[2];
    F.resize(12, 3);
    F << 0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5;
}

}  // namespace

int main() {
    const Vec3 a(0, 0, 0), b(1, 0, 0), c(0, 1, 0);

    LAW("touching counts, one unit in the last place apart does not");
    CHECK(triangles_intersect(a, b, c, Vec3(0.25, 0.25, 0), Vec3(0, 0, 1), Vec3(1, 0, 1)));
    const double above = std::nextafter(0.0, 1.0);
    CHECK(!triangles_intersect(a, b, c, Vec3(0.25, 0.25, above), Vec3(0, 0, 1), Vec3(1, 0, 1)));

    LAW("coplanar triangles intersect when they overlap, contain each other or share a corner");
    CHECK(triangles_intersect(a, b, c, Vec3(0.1, 0.1, 0), Vec3(0.2, 0.1, 0), Vec3(0.1, 0.2, 0)));
    CHECK(triangles_intersect(a, b, c, Vec3(1, 0, 0), Vec3(2, 0, 0), Vec3(2, 1, 0)));
    CHECK(!triangles_intersect(a, b, c, Vec3(1, 1, 0), Vec3(2, 1, 0), Vec3(2, 2, 0)));

    LAW("a triangle of no area is the segment or the point that it covers");
    CHECK(triangles_intersect(a, b, c, Vec3(0.2, 0.2, -1), Vec3(0.2, 0.2, 1), Vec3(0.2, 0.2, 0)));
    CHECK(!triangles_intersect(a, b, c, Vec3(0.8, 0.8, -1), Vec3(0.8, 0.8, 1), Vec3(0.8, 0.8, 0)));
    CHECK(triangles_intersect(a, b, c, c, c, c));
    CHECK(!triangles_intersect(b, b, b, c, c, c));
    CHECK(triangles_intersect(a, b, (a + b) / 2, Vec3(0.5, 1, 0), Vec3(0.5, -1, 0), Vec3(0.5, 0, 0)));

    LAW("the pairs of two cubes are those of all faces against all faces");
    Vertices V1, V2;
    Faces F1, F2;
    cube(Vec3::Zero(), V1, F1);
    cube(Vec3(0.3, 0.45, 0.6), V2, F2);
    std::vector<std::pair<int, int>> brute;
    for (int f = 0; f < 12; ++f)
        for (int g = 0; g < 12; ++g)
            if (triangles_intersect(V1.row(F1(f, 0)), V1.row(F1(f, 1)), V1.row(F1(f, 2)), V2.row(F2(g, 0)),
                                    V2.row(F2(g, 1)), V2.row(F2(g, 2))))
                brute.emplace_back(f, g);
    const Edges pairs = intersecting_pairs(V1, F1, V2, F2);
    CHECK(!brute.empty() && pairs.rows() == static_cast<Eigen::Index>(brute.size()));
    for (Eigen::Index k = 0; k < pairs.rows(); ++k)
        CHECK(pairs(k, 0) == brute[static_cast<std::size_t>(k)].first &&
              pairs(k, 1) == brute[static_cast<std::size_t>(k)].second);

    LAW("a cube does not intersect itself; two overlapping cubes in one mesh do, exactly as two meshes");
    CHECK(self_intersections(V1, F1).rows() == 0);
    Vertices V(16, 3);
    V << V1, V2;
    Faces F(24, 3);
    F << F1, (F2.array() + 8).matrix();
    CHECK(self_intersections(V, F).rows() == pairs.rows());

    LAW("winding numbers: 1 in a cube, 2 in the overlap of two, 0 outside");
    const WindingNumber winding(V, F);
    CHECK(std::abs(winding.at(Vec3(0.1, 0.1, 0.1)) - 1) < 1e-2);
    CHECK(std::abs(winding.at(Vec3(0.6, 0.7, 0.8)) - 2) < 1e-2);
    CHECK(std::abs(winding.at(Vec3(3, 3, 3))) < 1e-2);

    LAW("signed distances to a cube: negative inside");
    Vertices points(2, 3);
    points << 0.5, 0.5, 0.9, 0.5, 0.5, 1.25;
    const Vector d = signed_distance(points, SurfaceIndex(V1, F1), WindingNumber(V1, F1));
    CHECK(std::abs(d[0] + 0.1) < 1e-12 && std::abs(d[1] - 0.25) < 1e-12);

    LAW("bad indices are refused");
    F1(4, 2) = 8;
    CHECK_THROWS(InputError, intersecting_pairs(V1, F1, V2, F2));
    CHECK_THROWS(InputError, self_intersections(V1, F1));
    return toile_failures();
}
