// One surface of faces that lie beside each other but share no vertices, or are listed more than once.
#pragma once
#include <vector>

#include "base/types.h"

namespace toile {

/// Per vertex: on the border, or where faces meet in odd numbers.
std::vector<char> open_vertices(const Faces& F, Eigen::Index n);

/// Per face the first one with the same three corners, whatever their order.
std::vector<int> first_alike(const Faces& F, Eigen::Index n);

/// Faces of three different corners, the first of those with the same three, whatever their order.
Faces distinct_faces(const Faces& F, Eigen::Index n);

struct Welded {
    Faces F;              ///< distinct, in the numbers of the given vertices
    std::vector<int> to;  ///< per vertex the first one in the same place where both are open, else itself; empty: all
};

/// Seams, and triangles with corners of their own, become one surface. Closed parts that touch stay apart.
Welded weld(const Vertices& V, const Faces& F);

}  // namespace toile
