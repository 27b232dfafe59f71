#include "base/errors.h"
#include "check.h"
#include "kernels/biharmonic.h"

using namespace toile;

int main() {
    Vertices V(25, 3);
    Faces F(32, 3);
    for (int j = 0, f = 0; j < 5; ++j)
        for (int i = 0; i < 5; ++i) {
            V.row(5 * j + i) << 0.1 * i, 0.1 * j, 0;
            if (i == 4 || j == 4) continue;
            const int a = 5 * j + i;
            F.row(f++) << a, a + 1, a + 6;
            F.row(f++) << a, a + 6, a + 5;
        }
    Indices known(4);
    known << 24, 0, 4, 20;
    const BiharmonicSolver solver(V, F, known);

    LAW("translations come back exactly");
    Vertices D = Vertices::Constant(4, 3, 0.3);
    CHECK((solver.solve(D).array() == 0.3).all());

    LAW("known rows are kept in their order, and any number of solves needs one factorisation");
    D << 1, 0, 0, 0, 1, 0, 0, 0, 1, 2, 0, 0;
    const Vertices all = solver.solve(D);
    for (int k = 0; k < 4; ++k) CHECK(all.row(known[k]) == D.row(k));
    CHECK(solver.factorisations() == 1 && solver.mollified() == 0);

    LAW("bad input is refused");
    CHECK_THROWS(InputError, solver.solve(Vertices::Zero(3, 3)));
    known[1] = 24;
    CHECK_THROWS(InputError, BiharmonicSolver(V, F, known));
    return toile_failures();
}
