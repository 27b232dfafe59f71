#include <cmath>
#include <limits>

#include "base/errors.h"
#include "check.h"
#include "kernels/inner.h"
#include "tube.h"

using namespace toile;

namespace {

InnerFrame frame_of(const BodyModel& m, const Vertices& rest, const Vec3& bend) {
    InnerFrame f;
    f.rotations = Vertices::Zero(3, 3);
    f.rotations.row(1) = bend;
    f.translation = Vec3(0.1, 0.2, -0.3);
    f.tracked = skin_vertices(m, rest, m.J, pose_joints(m.parents, m.J, f.rotations, f.translation));
    f.visible = Vector::Ones(rest.rows());
    return f;
}

/// A sleeve round the tube's axis at rest from z0 to z1, `radius` times the tube's section.
InnerGarment sleeve(double radius) {
    BodyModel m = tube();
    InnerGarment g;
    g.V = m.v_template;
    g.V.leftCols(2) *= radius;
    g.F = m.F;
    return g;
}

}  // namespace

int main() {
    const BodyModel m = tube();
    const Eigen::Index n = m.v_template.rows();
    const Vector none;
    InnerOptions o;
    o.taper = 0;
    const InnerSolver solver(m, none, m.J, o);

    LAW("unskinning undoes skinning");
    const InnerFrame bent = frame_of(m, m.v_template, Vec3(0.4, -0.2, 0.3));
    const Posed posed = pose_joints(m.parents, m.J, bent.rotations, bent.translation);
    CHECK((unskin_vertices(m, bent.tracked, m.J, posed) - m.v_template).cwiseAbs().maxCoeff() < 1e-12);

    LAW("skin that is seen is given back to the bit, in the frame, and to a tenth of a millimetre fused");
    Vertices bumpy = m.v_template;
    for (Eigen::Index v = 0; v < n; ++v) bumpy.row(v).head<2>() *= 1 + 0.05 * std::sin(4 * bumpy(v, 2));
    const std::vector<InnerFrame> frames = {frame_of(m, bumpy, Vec3::Zero()), frame_of(m, bumpy, Vec3(0.3, 0, 0.2))};
    const InnerFused fused = solver.fuse(frames);
    CHECK((fused.rest - bumpy).rowwise().norm().maxCoeff() < 1e-4);
    CHECK(solver.solve(fused.rest, frames[1]).V == frames[1].tracked);

    LAW("a hidden band between seen ends is filled smoothly");
    std::vector<InnerFrame> banded = frames;
    for (InnerFrame& f : banded)
        for (Eigen::Index v = 0; v < n; ++v)
            if (std::abs(m.v_template(v, 2) - 0.6) < 0.15) {
                f.visible[v] = 0;
                f.tracked.row(v) += Eigen::RowVector3d(0.05, 0.05, 0);  // cloth, which must not count
            }
    const InnerFused filled = solver.fuse(banded);
    CHECK((filled.rest - bumpy).rowwise().norm().maxCoeff() < 3e-3);

    LAW("cloth inside the body pushes it in, wide cloth says nothing");
    InnerFrame dressed = frame_of(m, m.v_template, Vec3::Zero());
    dressed.translation.setZero();
    dressed.tracked = m.v_template;
    for (Eigen::Index v = 0; v < n; ++v)
        if (std::abs(m.v_template(v, 2) - 0.6) < 0.35) dressed.visible[v] = 0;
    dressed.garments = {sleeve(0.9)};
    const InnerResult tight = solver.solve(m.v_template, dressed);
    CHECK(tight.outside_before > 30 && tight.depth_before > 5e-3 && tight.depth_after < 1e-3);
    CHECK(tight.factorisations >= 1 && tight.factorisations <= tight.iterations);
    dressed.garments = {sleeve(1.4)};
    const InnerResult wide = solver.solve(m.v_template, dressed);
    CHECK((wide.V - m.v_template).rowwise().norm().maxCoeff() < 1e-9 && wide.factorisations == 1);

    LAW("what is wrong is refused by name and index");
    CHECK_THROWS(InputError, solver.fuse({}));
    InnerFrame bad = dressed;
    bad.visible[4] = 1.5;
    CHECK_THROWS(InputError, solver.solve(m.v_template, bad));
    bad = dressed;
    bad.garments[0].F(2, 1) = 100000;
    CHECK_THROWS(InputError, solver.fuse({bad}));
    return toile_failures();
}
