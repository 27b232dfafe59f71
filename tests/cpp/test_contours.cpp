#include "kernels/contours.h"

#include <cmath>

#include "base/errors.h"
#include "check.h"
#include "geometry/topology.h"

using namespace toile;

int main() {
    ContourView view;  // a square of 3 x 3 pixels between emptiness, at z = 2
    view.vertices_camera.resize(4, 3);
    view.vertices_camera << -3, -3, 2, 3, -3, 2, 3, 3, 2, -3, 3, 2;
    view.faces.resize(2, 3);
    view.faces << 0, 1, 2, 0, 2, 3;
    view.neighbours = face_neighbours(view.faces);
    view.K << 1, 0, 2.75, 0, 1, 2.75, 0, 0, 1;
    view.face = FaceIds::Constant(6, 6, -1);
    view.face.block(1, 1, 3, 3).setZero();
    view.face(1, 3) = view.face(1, 2) = view.face(2, 3) = 0;
    view.face(2, 1) = view.face(3, 1) = view.face(3, 2) = 1;
    view.depth = Matrix::Constant(6, 6, 2);

    LAW("a square has a contour at the end of each of its rows and columns, where its border is");
    const Contours contours(view, 0.01);
    CHECK(contours.points().size() == 12);
    for (const ContourPoint& p : contours.points()) {
        const Eigen::RowVector3d at =
            (1 - p.share) * view.vertices_camera.row(p.i) + p.share * view.vertices_camera.row(p.j);
        const double x = at[0] / 2 + 2.75, y = at[1] / 2 + 2.75;
        CHECK(p.below ? (std::abs(y - 1.25) < 1e-12 || std::abs(y - 4.25) < 1e-12)
                      : (std::abs(x - 1.25) < 1e-12 || std::abs(x - 4.25) < 1e-12));
        CHECK(p.share >= 0 && p.share <= 1);
    }

    LAW("of a square's border only what touches the pixels asked for");
    view.of = PixelMask::Constant(6, 6, false);
    view.of(1, 2) = view.of(5, 5) = true;
    CHECK(Contours(view, 0.01).points().size() == 1);
    view.of = PixelMask::Constant(5, 6, true);
    CHECK_THROWS(InputError, Contours(view, 0.01));
    view.of.resize(0, 0);

    LAW("a covered area grows with each side by three pixels a pixel");
    Planes picture(1, 36), one = Planes::Ones(1, 36);
    for (int k = 0; k < 36; ++k) picture(0, k) = view.face(k / 6, k % 6) >= 0 ? 1.0f : 0.0f;
    const Vertices slope = contours.gradient(picture, one);
    CHECK(std::abs(slope(1, 0) + slope(2, 0) - 3 / 2.0) < 1e-9);
    CHECK(std::abs(slope(0, 0) + slope(3, 0) + 3 / 2.0) < 1e-9);
    CHECK(std::abs(slope(2, 1) + slope(3, 1) - 3 / 2.0) < 1e-9);

    LAW("bad input is refused");
    CHECK_THROWS(InputError, contours.gradient(picture, Planes::Ones(2, 36)));
    CHECK_THROWS(InputError, contours.gradient(Planes::Ones(1, 35), Planes::Ones(1, 35)));
    CHECK_THROWS(InputError, Contours(view, 0));
    view.neighbours(0, 0) = 2;
    CHECK_THROWS(InputError, Contours(view, 0.01));
    view.neighbours(0, 0) = -1;
    view.face(0, 0) = 2;
    CHECK_THROWS(InputError, Contours(view, 0.01));
    return toile_failures();
}
