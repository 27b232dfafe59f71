#include "kernels/nricp.h"

#include <Eigen/Geometry>
#include <random>

#include "base/errors.h"
#include "check.h"
#include "geometry/border.h"
#include "geometry/laplacian.h"
#include "geometry/nodes.h"
#include "geometry/oriented_tree.h"
#include "tube.h"

using namespace toile;

namespace {

struct Cloud {
    Vertices X, N;
};

Cloud random_cloud(int count, unsigned seed) {
    std::mt19937 next(seed);
    std::uniform_real_distribution<double> uniform(-1, 1);
    Cloud c{Vertices(count, 3), Vertices(count, 3)};
    for (int i = 0; i < count; ++i) {
        c.X.row(i) << uniform(next), uniform(next), uniform(next);
        c.N.row(i) << uniform(next), uniform(next), uniform(next);
    }
    c.N.rowwise().normalize();
    return c;
}

double squared(const Cloud& c, int i, const Cloud& q, int j, double spread) {
    return (c.X.row(i) - q.X.row(j)).squaredNorm() + spread * spread * (c.N.row(i) - q.N.row(j)).squaredNorm() / 2;
}

bool finds_the_nearest(const OrientedTree& tree, const Cloud& cloud, double spread, int guess) {
    const Cloud queries = random_cloud(200, 7);
    for (int j = 0; j < 200; ++j) {
        const int found = tree.nearest(queries.X.row(j).transpose(), queries.N.row(j).transpose(), spread, 10, guess);
        double least = INFINITY;
        for (int i = 0; i < cloud.X.rows(); ++i) least = std::min(least, squared(cloud, i, queries, j, spread));
        if (found < 0 || squared(cloud, found, queries, j, spread) > least * (1 + 1e-5)) return false;
    }
    return true;
}

}  // namespace

int main() {
    LAW("the oriented tree finds the nearest point of every size, with and without a guess") {
        for (int count : {1, 7, 8, 9, 64, 65, 1000, 5000}) {
            const Cloud cloud = random_cloud(count, 1);
            const OrientedTree tree(cloud.X, cloud.N);
            for (double spread : {0.0, 0.3}) {
                CHECK(finds_the_nearest(tree, cloud, spread, -1));
                CHECK(finds_the_nearest(tree, cloud, spread, count / 2));
            }
        }
    }
    LAW("the oriented tree follows moving points") {
        const Cloud before = random_cloud(3000, 1), after = random_cloud(3000, 2);
        OrientedTree tree(before.X, before.N);
        tree.follow(after.X, after.N);
        CHECK(finds_the_nearest(tree, after, 0.3, 5));
    }
    LAW("the oriented tree finds nothing beyond reach, nor in an empty cloud") {
        const Cloud cloud = random_cloud(100, 1);
        CHECK(OrientedTree(cloud.X, cloud.N).nearest(Vec3(9, 0, 0), Vec3(1, 0, 0), 0, 1) == -1);
        CHECK(OrientedTree(Vertices(0, 3), Vertices(0, 3)).nearest(Vec3::Zero(), Vec3::UnitX(), 0, 1) == -1);
    }
    const BodyModel body = tube();
    const Vertices& V = body.v_template;
    LAW("every vertex lies within the radius of a node, and weights sum to one") {
        const GeodesicGraph surface(V, body.F);
        for (double radius : {0.01, 0.1, 10.0}) {
            const DeformationNodes nodes = deformation_nodes(surface, radius);
            CHECK(radius < 1 || nodes.size() == 1);
            for (int v = 0; v < V.rows(); ++v) {
                double sum = 0;
                for (int a = nodes.start[v]; a < nodes.start[v + 1]; ++a) sum += nodes.weight[a];
                CHECK(std::abs(sum - 1) < 1e-12);
            }
        }
    }
    LAW("a tube has two borders, of its circumference, that face along it; a hole in a flat sheet faces nowhere") {
        const std::vector<Border> ends = borders(V, vertex_normals(V, body.F), body.F);
        CHECK(ends.size() == 2 && ends[0].vertex.front() == 0 && ends[0].vertex.size() == 12);
        double around = 0;
        for (int s = 0; s < 12; ++s) around += (V.row((s + 1) % 12) - V.row(s)).norm();
        for (const Border& end : ends) {
            const double z = &end == &ends[0] ? -1 : 1;
            CHECK(std::abs(end.total() - around) < 1e-12);
            CHECK((end.facing() - Eigen::RowVector3d(0, 0, z)).norm() < 1e-12);
        }
        Vertices ring(8, 3);
        ring << 1, 1, 0, -1, 1, 0, -1, -1, 0, 1, -1, 0, 3, 3, 0, -3, 3, 0, -3, -3, 0, 3, -3, 0;
        Faces sheet(8, 3);
        for (int i = 0; i < 4; ++i) {
            const int j = (i + 1) % 4;
            sheet.row(2 * i) << i, i + 4, j + 4;
            sheet.row(2 * i + 1) << i, j + 4, j;
        }
        const std::vector<Border> hole = borders(ring, vertex_normals(ring, sheet), sheet);
        CHECK(hole.size() == 2 && hole[0].facing().norm() < 1e-12);
        CHECK(hole[0].conormal(0, 0) < 0 && hole[1].conormal(0, 0) > 0);
    }
    LAW("a template that lies on its scan stays; a rigid motion is found") {
        NricpSolver solver(V, body.F);
        CHECK((solver.solve({V, body.F, {}, {}, {}, {}}).V - V).cwiseAbs().maxCoeff() < 1e-6);
        const Eigen::AngleAxisd turn(0.1, Vec3(1, 2, 3).normalized());
        const Vertices moved =
            (V * turn.toRotationMatrix().transpose()).rowwise() + Eigen::RowVector3d(0.02, -0.03, 0.01);
        const NricpResult found = solver.solve({moved, body.F, {}, {}, {}, {}});
        CHECK((found.V - moved).cwiseAbs().maxCoeff() < 2e-3);
    }
    LAW("a scan out of reach is flagged, a bad one refused") {
        NricpSolver solver(V, body.F);
        Vertices bad = V.rowwise() + Eigen::RowVector3d(50, 0, 0);
        CHECK(solver.solve({bad, body.F, {}, {}, {}, {}}).stop == Stop::no_overlap);
        bad(3, 1) = NAN;
        CHECK_THROWS(InputError, solver.solve({bad, body.F, {}, {}, {}, {}}));
        CHECK_THROWS(InputError, nricp_preset("best"));
    }
    return toile_failures();
}
