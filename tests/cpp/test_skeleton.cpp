#include <cmath>
#include <limits>

#include "base/errors.h"
#include "check.h"
#include "kernels/skeleton.h"
#include "tube.h"

using namespace toile;

namespace {

BodyState bent() {
    Vertices r(3, 3);
    r << 0.2, -0.3, 0.5, 0.4, 0.1, -0.2, -0.3, 0.5, 0.3;
    Vector shape(2);
    shape << 0.7, -0.4;
    return {rotation_matrices(r), Vec3(0.3, -0.1, 0.2), shape};
}

BodyState nudged(const BodyState& s, int unknown, double h) {
    BodyState out = s;
    if (unknown < 9) {
        Vec3 u = Vec3::Zero();
        u[unknown % 3] = h;
        out.local[static_cast<std::size_t>(unknown / 3)] =
            rotation_matrix(u) * s.local[static_cast<std::size_t>(unknown / 3)];
    } else if (unknown < 12)
        out.translation[unknown - 9] += h;
    else
        out.shape[unknown - 12] += h;
    return out;
}

SkeletonSolver solver(const BodyModel& m, SkeletonOptions o = {}) {
    return SkeletonSolver(m, Vector::Constant(3, std::numeric_limits<double>::infinity()), Vector::Constant(3, 10.0),
                          Vector::Ones(m.v_template.rows()), o);
}

}  // namespace

int main() {
    const BodyModel m = tube();
    const BodyState state = bent();
    const PosedBody body(m, state, true);
    const Vec3 direction(0.3, -0.8, 0.5);

    LAW("derivatives of vertices and joints equal central differences");
    BodyGradient g(m);
    double worst = 0;
    for (int item = 0; item < 156 + 3; item += item < 150 ? 7 : 1) {
        const bool vertex = item < 156;
        g.clear();
        if (vertex)
            body.add_vertex(item, direction, g);
        else
            body.add_joint(item - 156, direction, g);
        for (int u = 0; u < 14; ++u) {
            const double h = 1e-5;
            const PosedBody plus(m, nudged(state, u, h), false), minus(m, nudged(state, u, -h), false);
            const Vec3 d =
                vertex ? plus.vertex(item) - minus.vertex(item) : plus.joint(item - 156) - minus.joint(item - 156);
            worst = std::max(worst, std::abs(direction.dot(d) / (2 * h) - g.values[u]));
        }
    }
    CHECK(worst < 1e-9);

    LAW("the rotation vector's derivative equals central differences, also close to no rotation");
    for (const Vec3& r : {Vec3(0.4, -0.9, 1.3), Vec3(1e-6, 2e-6, 0), Vec3(0, 0, 3.0)}) {
        const Mat3 J = log_jacobian(r);
        for (int c = 0; c < 3; ++c) {
            const Vec3 u = 1e-6 * Vec3::Unit(c);
            const Vec3 d = (rotation_log(rotation_matrix(u) * rotation_matrix(r)) -
                            rotation_log(rotation_matrix(-u) * rotation_matrix(r))) /
                           2e-6;
            CHECK((d - J.col(c)).norm() < 1e-7);
        }
    }

    LAW("keypoints and surface of the model itself bring back pose and shape");
    SkeletonFrame frame;
    frame.scan_V = body.vertices();
    frame.scan_F = m.F;
    frame.keypoints.index.setLinSpaced(8, 0, 7);
    frame.keypoints.points.resize(8, 3);
    frame.keypoints.sigma = Vector::Constant(8, 0.005);
    for (int i = 0; i < 8; ++i) {
        const BodyKeypoint& k = m.keypoints[static_cast<std::size_t>(i)];
        frame.keypoints.points.row(i) =
            k.joint >= 0 ? body.joint(k.joint) : Vec3(0.5 * (body.vertex(k.vertices[0]) + body.vertex(k.vertices[1])));
    }
    SkeletonOptions weak;
    weak.shape_weight = 1e-6;
    weak.tolerance = 1e-6;
    const SkeletonResult exact = solver(m, weak).solve(frame);
    CHECK(exact.stop == Stop::converged && (exact.V - body.vertices()).rowwise().norm().maxCoeff() < 1e-5);
    CHECK((exact.pose.shape - state.shape).norm() < 1e-3);

    LAW("the energy of a solve never rises once its correspondences are good");
    for (std::size_t i = exact.energy.size() / 2 + 1; i < exact.energy.size(); ++i)
        CHECK(exact.energy[i] <= exact.energy[i - 1] * (1 + 1e-9) + 1e-12);

    LAW("a start beside the answer needs no keypoints");
    SkeletonFrame warm = frame;
    warm.keypoints = {};
    warm.start = {exact.pose};
    warm.start[0].translation += Vec3(0.01, 0, 0.005);
    const SkeletonResult surface = solver(m, weak).solve(warm);
    CHECK((surface.joints - exact.joints).rowwise().norm().maxCoeff() < 2e-3);

    LAW("a locked joint keeps its start and a fixed shape its value");
    Vector sigma = Vector::Constant(3, std::numeric_limits<double>::infinity());
    sigma[1] = 0;
    SkeletonOptions fixed;
    fixed.solve_shape = false;
    const SkeletonResult locked =
        SkeletonSolver(m, sigma, Vector::Constant(3, 10.0), Vector::Ones(156), fixed).solve(warm);
    CHECK((locked.pose.rotations.row(1) - exact.pose.rotations.row(1)).norm() < 1e-9 &&
          locked.pose.shape == exact.pose.shape);

    LAW("two frames of one body share its shape");
    SkeletonFrame other = frame;
    BodyState rest = bent();
    rest.local.assign(3, Mat3::Identity());
    const PosedBody standing(m, rest, false);
    other.keypoints = {};
    other.scan_V = standing.vertices();
    const auto both = solver(m, weak).solve_shared({frame, other});
    CHECK(both[0].pose.shape == both[1].pose.shape && (both[0].pose.shape - state.shape).norm() < 0.05);

    LAW("what is wrong is refused by name and index");
    SkeletonFrame bad = frame;
    bad.keypoints.index[2] = 99;
    CHECK_THROWS(InputError, solver(m).solve(bad));
    CHECK_THROWS(InputError, solver(m).solve(SkeletonFrame{}));
    bad = frame;
    bad.scan_V(3, 1) = std::numeric_limits<double>::quiet_NaN();
    CHECK_THROWS(InputError, solver(m).solve(bad));
    return toile_failures();
}
