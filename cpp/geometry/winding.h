// Inside or outside, for meshes that intersect themselves, overlap or have holes: generalized winding numbers
// (Jacobson et al. 2013), far faces summed over a tree by their first two moments (Barill et al. 2018).
#pragma once
#include <cmath>
#include <vector>

#include "../base/types.h"
#include "box_tree.h"
#include "closest.h"

namespace toile {

/// Sums over the faces below each node of a tree; good for the positions that the tree had.
class WindingMoments {
public:
    explicit WindingMoments(const BoxTree& tree);
    double at(const BoxTree& tree, const Vec3& p) const;  ///< the winding number; `tree` as given before
    double volume() const;                                ///< [m^3]; negative where faces look inwards

private:
    struct Moments {
        Vec3 centre = Vec3::Zero();  ///< area-weighted mean of face centres
        Vec3 normal = Vec3::Zero();  ///< sum of area vectors [m^2]
        Mat3 spread = Mat3::Zero();  ///< sum of area vector x (face centre - centre)' [m^3]
        double area = 0;             ///< [m^2]
        double radius = 0;           ///< of a ball about the centre that holds the node's faces [m]
    };
    static Moments of_leaf(const BoxTree& tree, const BoxTree::Node& leaf);
    static Moments of_both(const Moments& left, const Moments& right, const Box& box);

    std::vector<Moments> moments_;
};

/// How often the mesh winds around p: 1 inside and 0 outside of a closed, outward oriented surface; 2 where two such
/// parts overlap; fractions near holes.
class WindingNumber {
public:
    WindingNumber(const Vertices& V, const Faces& F) : tree_(V, F), moments_(tree_) {}
    double at(const Vec3& p) const { return moments_.at(tree_, p); }
    bool inside(const Vec3& p) const { return std::abs(at(p)) > 0.5; }  ///< faces may all look inwards

private:
    BoxTree tree_;
    WindingMoments moments_;
};

Vector winding_numbers(const Vertices& points, const WindingNumber& winding);  ///< parallel

/// Distance to the surface [m], negative inside (winding number beyond 1/2, either way). Where the mesh overlaps itself
/// the distance is to the nearest face, which may lie inside the solid.
Vector signed_distance(const Vertices& points, const SurfaceIndex& index, const WindingNumber& winding);

}  // namespace toile
