#include "kernels/untangle.h"

#include <cmath>
#include <numbers>

#include "base/errors.h"
#include "check.h"
#include "geometry/intersect.h"

using namespace toile;

namespace {

/// A closed sphere of `rows` rings and `columns` meridians, outward faces.
void sphere(double radius, int rows, int columns, Vertices& V, Faces& F) {
    V.resize(rows * columns + 2, 3);
    F.resize(2 * rows * columns, 3);
    const int south = rows * columns, north = south + 1;
    for (int i = 0; i < rows; ++i)
        for (int j = 0; j < columns; ++j) {
            const double theta = std::numbers::pi * (i + 1) / (rows + 1), phi = 2 * std::numbers::pi * j / columns;
            V.row(i * columns + j) << radius * std::sin(theta) * std::cos(phi),
                radius * std::sin(theta) * std::sin(phi), -radius * std::cos(theta);
        }
    V.row(south) << 0, 0, -radius;
    V.row(north) << 0, 0, radius;
    int f = 0;
    for (int j = 0; j < columns; ++j) {
        const int next = (j + 1) % columns;
        F.row(f++) << south, next, j;
        F.row(f++) << north, (rows - 1) * columns + j, (rows - 1) * columns + next;
        for (int i = 0; i + 1 < rows; ++i) {
            const int a = i * columns + j, b = i * columns + next;
            F.row(f++) << a, b, b + columns;
            F.row(f++) << a, b + columns, a + columns;
        }
    }
}

}  // namespace

int main() {
    Vertices body_V;
    Faces body_F;
    sphere(0.2, 16, 32, body_V, body_F);
    const Vertices cloth_V = 0.96 * body_V;

    LAW("a shell inside a sphere comes out, with no pair and no vertex left");
    const UntangleResult r = untangle(cloth_V, body_F, body_V, body_F);
    CHECK(r.stop == Stop::clear && r.vertices_left == 0 && r.intersections_left == 0 && r.reason.empty());
    CHECK(intersecting_pairs(r.V, body_F, body_V, body_F).rows() == 0);
    CHECK(r.depth_before.minCoeff() > 0.005 && r.depth_after.maxCoeff() == 0);

    LAW("a sequence ends where single frames end, bit for bit");
    UntangleSolver solver(body_F, body_V.rows(), body_F, body_V.rows());
    for (double scale : {0.97, 0.96}) {
        const Vertices frame = scale * body_V;
        CHECK(solver.solve(frame, body_V).V == untangle(frame, body_F, body_V, body_F).V);
    }

    LAW("wrong sizes, bad options and bad indices are refused");
    CHECK_THROWS(InputError, solver.solve(cloth_V.topRows(10), body_V));
    UntangleOptions options;
    options.margin = -1;
    CHECK_THROWS(InputError, untangle(cloth_V, body_F, body_V, body_F, options));
    Faces bad = body_F;
    bad(2, 2) = -1;
    CHECK_THROWS(InputError, untangle(cloth_V, bad, body_V, body_F));
    return toile_failures();
}
