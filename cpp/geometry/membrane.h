// Displacements of a mesh that vary as little as half-spaces for its vertices allow.
#pragma once
#include <vector>

#include "base/types.h"
#include "geometry/topology.h"

namespace toile {

/// Up to two half-spaces { d : normal . d >= least } for the displacement d of one vertex.
struct HalfSpaces {
    Vec3 normal[2] = {Vec3::Zero(), Vec3::Zero()};  ///< unit
    double least[2] = {0, 0};                       ///< [m]
    int count = 0;

    void add(const Vec3& n, double at_least) { normal[count] = n, least[count++] = at_least; }
    static HalfSpaces one(const Vec3& n, double at_least) {
        HalfSpaces h;
        h.add(n, at_least);
        return h;
    }
};

/// Minimises  sum over edges |d_i - d_j|^2 + stiffness sum_i |d_i|^2  over d_i in the half-spaces of vertex i: a strictly
/// convex problem, solved by projected successive over-relaxation (Cryer 1971) from the d given. Vertices are updated in
/// breadth-first blocks; what joins two blocks is updated after them, so blocks may run side by side and bits stay.
class Membrane {
public:
    explicit Membrane(const Adjacency& ring);

    /// Until no vertex moves further than `tolerance` [m] in a sweep; returns the number of sweeps.
    int relax(Vertices& d, const std::vector<HalfSpaces>& bounds, double stiffness, double tolerance,
              int max_sweeps) const;

private:
    struct Range {
        int begin, end;
    };
    double update(Matrix& d, int k, const HalfSpaces& bounds, double stiffness, double over) const;

    std::vector<int> vertex_;       ///< vertices in the order of updates; rows below are in this order
    std::vector<int> start_, row_;  ///< neighbours of a row, as rows
    std::vector<Range> blocks_;     ///< independent of each other
    Range joints_{0, 0};            ///< rows that have neighbours in another block
};

}  // namespace toile
