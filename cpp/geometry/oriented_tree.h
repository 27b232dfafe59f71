// Nearest of many points with normals: a tree of boxes over (x, n) that follows moving points without a new sort.
#pragma once
#include <vector>

#include "base/types.h"

namespace toile {

/// Measures |x - x'|^2 + spread^2 |n - n'|^2 / 2 = |x - x'|^2 + spread^2 (1 - n . n') for unit normals; `spread` [m] is
/// what opposite normals are worth. In float32: centre and scale the points first. Queries are safe from several threads.
class OrientedTree {
public:
    OrientedTree() = default;
    OrientedTree(const Vertices& X, const Vertices& N);

    void follow(const Vertices& X, const Vertices& N);  ///< new places of the same points: boxes only, in O(n)

    /// The nearest point within `reach` [m], ties to the smallest index; -1 where there is none. `guess` is a point that
    /// may be near (-1: none): it saves time and never changes the answer.
    int nearest(const Vec3& x, const Vec3& n, double spread, double reach, int guess = -1) const;

private:
    static constexpr int wide = 8;                       ///< points of a leaf and children of a box: one vector
    typedef float Row __attribute__((vector_size(32)));  ///< one coordinate of eight things
    struct Leaf {
        Row at[6];
        int point[wide];  ///< ascending; -1: an empty place, far away
    };
    struct Boxes {
        Row low[6], high[6];
    };
    struct Place {
        float at[6];
        int point;
    };
    static void split(Place* begin, Place* middle, Place* end);
    void fit(std::size_t group);

    std::vector<Leaf> leaves_;  ///< 8^k of them
    std::vector<Boxes> boxes_;  ///< of the children of every inner node, root first, level by level
    std::vector<int> leaf_of_;  ///< of each point
};

}  // namespace toile
