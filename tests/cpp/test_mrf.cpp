#include <cmath>
#include <random>

#include "base/errors.h"
#include "check.h"
#include "geometry/maxflow.h"
#include "kernels/mrf.h"

using namespace toile;

namespace {

/// The least cut over all subsets of nodes, for small graphs.
double least_cut(const Vector& terminal, const Edges& edges, const Vector& forward, const Vector& backward) {
    double best = INFINITY;
    for (int subset = 0; subset < 1 << terminal.size(); ++subset) {
        const auto source = [&](int v) { return (subset >> v & 1) != 0; };
        double cut = 0;
        for (int v = 0; v < terminal.size(); ++v)
            cut += source(v) ? std::max(0.0, -terminal[v]) : std::max(0.0, terminal[v]);
        for (int e = 0; e < edges.rows(); ++e) {
            if (source(edges(e, 0)) && !source(edges(e, 1))) cut += forward[e];
            if (!source(edges(e, 0)) && source(edges(e, 1))) cut += backward[e];
        }
        best = std::min(best, cut);
    }
    return best;
}

}  // namespace

int main() {
    LAW("the cut of a random graph is the least over all subsets of its nodes");
    std::mt19937 random(1);
    const auto draw = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
    for (int trial = 0; trial < 400; ++trial) {
        const int n = 2 + draw(9), m = draw(3 * n);
        Edges edges(m, 2);
        Vector forward(m), backward(m), terminal(n);
        for (int e = 0; e < m; ++e) {
            edges(e, 0) = draw(n);
            edges(e, 1) = (edges(e, 0) + 1 + draw(n - 1)) % n;
            forward[e] = draw(8);
            backward[e] = draw(8);
        }
        for (int v = 0; v < n; ++v) terminal[v] = draw(25) - 12;
        MaxFlow flow(n, edges);
        for (int repeat = 0; repeat < 2; ++repeat) {  // a graph serves again
            for (int v = 0; v < n; ++v) {
                flow.set_terminal(v, terminal[v]);
                for (int a = flow.arcs_begin(v); a < flow.arcs_end(v); ++a) {
                    const int e = flow.edge(a);
                    flow.set_arc(a, edges(e, 0) == v ? forward[e] : backward[e]);
                }
            }
            flow.solve();
            double cut = 0;
            for (int v = 0; v < n; ++v)
                cut += flow.source_side(v) ? std::max(0.0, -terminal[v]) : std::max(0.0, terminal[v]);
            for (int e = 0; e < m; ++e) {
                const bool p = flow.source_side(edges(e, 0)), q = flow.source_side(edges(e, 1));
                cut += p && !q ? forward[e] : q && !p ? backward[e] : 0;
            }
            CHECK(cut == least_cut(terminal, edges, forward, backward));
        }
    }

    LAW("a chain pulled at both ends breaks at its weakest edge");
    Matrix unary = Matrix::Zero(4, 2);
    unary(0, 1) = unary(3, 0) = 10;
    Edges chain(3, 2);
    chain << 0, 1, 1, 2, 2, 3;
    Vector weights(3);
    weights << 3, 1, 2;
    const MrfResult result = mrf(unary, chain, weights);
    CHECK(result.energy == 1 && result.labels == Indices({{0, 0, 1, 1}}) && result.stop == Stop::converged);

    LAW("bad input is refused");
    weights[1] = -1;
    CHECK_THROWS(InputError, mrf(unary, chain, weights));
    return toile_failures();
}
