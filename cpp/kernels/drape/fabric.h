// What holds a cloth together: edges and hinges, ordered so that those of one colour share no vertex.
#pragma once
#include <array>
#include <vector>

#include "base/types.h"

namespace toile {

/// Groups [start, end) of constraints. Those of a group share no vertex, but for the last, which is swept in order.
struct Colours {
    std::vector<int> start{0};
};

class Fabric {
public:
    struct Edge {
        int i, j;
        double length, compliance;  ///< [m], [m/N]
    };
    struct Hinge {
        std::array<int, 4> at;            ///< the ends of the edge, and the corners across it
        std::array<double, 4> cotangent;  ///< coefficients, their sum is 0
        double compliance;                ///< [m/N] of the vector sum_i cotangent_i x_i
    };

    Fabric(const Faces& F, Eigen::Index n, const Vector& lengths, double density, double stretch, double bending);

    /// One sweep over all constraints in a substep of h [s]. `w` (n,) inverse masses [1/kg], 0 of what does not move.
    void relax(Vertices& x, const Vector& w, double h) const;
    double strain(const Vertices& x) const;       ///< of the most stretched edge
    const Vector& mass() const { return mass_; }  ///< (n,) [kg], 0 of vertices without faces

private:
    void add_edges(const Edges& edges, const Vector& lengths, const Vector& areas, double stretch);
    void add_hinges(const Faces& F, const Edges& edges, const Vector& lengths, double bending);

    std::vector<Edge> edges_;
    std::vector<Hinge> hinges_;
    Colours edge_colours_, hinge_colours_;
    Vector mass_;
};

}  // namespace toile
