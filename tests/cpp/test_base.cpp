#include <omp.h>
#include <sys/wait.h>
#include <unistd.h>

#include <Eigen/Core>
#include <cmath>

#include "base/errors.h"
#include "base/parallel.h"
#include "base/sparse.h"
#include "check.h"
#include "geometry/closest.h"
#include "geometry/laplacian.h"
#include "geometry/topology.h"

using namespace toile;

namespace {

/// A square of (n+1)^2 vertices in the plane z = 0, side 1.
void square(int n, Vertices& V, Faces& F) {
    V.resize((n + 1) * (n + 1), 3);
    F.resize(2 * n * n, 3);
    for (int j = 0; j <= n; ++j)
        for (int i = 0; i <= n; ++i) V.row(j * (n + 1) + i) << double(i) / n, double(j) / n, 0;
    for (int j = 0, f = 0; j < n; ++j)
        for (int i = 0; i < n; ++i) {
            const int a = j * (n + 1) + i;
            F.row(f++) << a, a + 1, a + n + 2;
            F.row(f++) << a, a + n + 2, a + n + 1;
        }
}

}  // namespace

int main() {
    Vertices V;
    Faces F;
    square(8, V, F);

    LAW("a square has one boundary loop through all its border vertices");
    const auto loops = boundary_loops(F);
    CHECK(loops.size() == 1 && loops[0].size() == 32);

    LAW("masses sum to the area and the Laplacian annihilates linear functions inside");
    CHECK(std::abs(voronoi_mass(V, F).sum() - 1) < 1e-12);
    const Vector Lx = cotangent_laplacian(V, F) * V.col(0);
    const auto border = border_vertices(F, V.rows());
    for (Eigen::Index v = 0; v < V.rows(); ++v)
        if (!border[static_cast<std::size_t>(v)]) CHECK(std::abs(Lx[v]) < 1e-12);

    LAW("the closest point above a square is straight below, far from the origin too");
    Vertices far = V;
    far.rowwise() += Eigen::RowVector3d(1e6, -1e6, 1e6);
    for (const Vertices& W : {V, far}) {
        const SurfaceIndex index(W, F);
        const Vec3 corner = W.row(0);
        const auto hit = index.closest(corner + Vec3(0.3, 0.6, 0.2));
        CHECK(hit.face >= 0 && (hit.point - corner - Vec3(0.3, 0.6, 0)).norm() < 1e-9);
        CHECK(index.first_hit(corner + Vec3(0.3, 0.6, 0.2), Vec3(0, 0, -1)).face == hit.face);
        CHECK(index.closest(corner + Vec3(0.3, 0.6, 0.2), 0.1).face == -1);
    }

    LAW("a Cholesky factor solves, counts its factorisations and refuses an indefinite matrix");
    Sparse A(3, 3);
    for (int i = 0; i < 3; ++i) A.insert(i, i) = 2;
    A.insert(1, 0) = -1;
    A.makeCompressed();
    CholeskyFactor factor;
    factor.factorize(A);
    const Matrix x = factor.solve(Matrix::Ones(3, 1));
    CHECK(std::abs(x(0, 0) - 1) < 1e-14 && std::abs(x(2, 0) - 0.5) < 1e-14);
    A.coeffRef(0, 0) = -2;
    CHECK_THROWS(SolveError, factor.factorize(A));
    CHECK(factor.factorisations() == 2 && factor.analyses() == 1);

    LAW("another pattern of the same size is analysed anew, a copied analysis gives the same bits without one of its "
        "own");
    Sparse B(3, 3);
    for (int i = 0; i < 3; ++i) B.insert(i, i) = 2;
    B.insert(2, 0) = -1;
    B.makeCompressed();
    factor.factorize(B);
    CHECK(std::abs(factor.solve(Matrix::Ones(3, 1))(2, 0) - 1) < 1e-14 && factor.analyses() == 2);
    CholeskyFactor analysed;
    CHECK_THROWS(InputError, analysed.symbolic());
    analysed.analyze(B);
    CholeskyFactor copy = analysed.symbolic();
    copy.factorize(B);
    CHECK(copy.analyses() == 0 && copy.factorisations() == 1 && analysed.factorisations() == 0);
    CHECK(copy.solve(Matrix::Ones(3, 2)) == factor.solve(Matrix::Ones(3, 2)));

    LAW("a Cholesky factor of panels of every width solves any number of right-hand sides, in single precision three");
    for (const int side : {2, 5, 9, 23}) {
        std::vector<Eigen::Triplet<double>> entries;
        for (int i = 0; i < side * side; ++i) {
            entries.emplace_back(i, i, 4.1);
            if (i % side > 0) entries.emplace_back(i, i - 1, -1);
            if (i >= side) entries.emplace_back(i, i - side, -1);
        }
        Sparse grid(side * side, side * side);
        grid.setFromTriplets(entries.begin(), entries.end());
        CholeskyFactor panels;
        panels.factorize(grid);
        for (int k = 1; k <= 9; ++k) {
            const Matrix expected = Matrix::Random(side * side, k);
            const Matrix image = grid.selfadjointView<Eigen::Lower>() * expected;
            CHECK((panels.solve(image) - expected).cwiseAbs().maxCoeff() < 1e-13);
        }
        const Vertices wanted = Vertices::Random(side * side, 3);
        const Vertices right = grid.selfadjointView<Eigen::Lower>() * wanted;
        CHECK((SingleFactor(panels).solve(right) - wanted).cwiseAbs().maxCoeff() < 1e-5);
    }

    LAW("ordered sums are the plain blocked sum");
    const double sum = parallel_sum<double>(10000, 0.0, [](double& s, std::int64_t i) { s += 1.0 / (1 + double(i)); });
    double plain = 0;
    for (int b = 0; b < 10; ++b) {
        double part = 0;
        for (int i = b * 1024; i < std::min(10000, (b + 1) * 1024); ++i) part += 1.0 / (1 + double(i));
        plain += part;
    }
    CHECK(sum == plain);

    LAW("dense products are the same for any number of threads, and end in a forked child");
    const Eigen::MatrixXd tall = Eigen::MatrixXd::Random(2000, 160);
    omp_set_num_threads(1);
    const Eigen::MatrixXd one = tall.transpose() * tall;
    omp_set_num_threads(4);
    const Eigen::MatrixXd four = tall.transpose() * tall;
    CHECK(one == four);
    const pid_t child = fork();
    if (child == 0) {
        alarm(10);  // that waits for threads which it does not have
        const Eigen::MatrixXd again = tall.transpose() * tall;
        _exit(again == one ? 0 : 1);
    }
    int status = -1;
    waitpid(child, &status, 0);
    CHECK(status == 0);

    LAW("bad indices are refused with their row");
    Faces bad = F;
    bad(3, 1) = 1000;
    CHECK_THROWS(InputError, check_mesh("test", V, bad));
    return toile_failures();
}
