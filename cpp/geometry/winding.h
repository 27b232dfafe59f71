// Inside or outside, for meshes that intersect themselves, overlap or have holes: generalized winding numbers
// (Jacobson et al. 2013), far faces summed over a tree by their first two moments (Barill et al. 2018).
#pragma once
#include <vector>

#include "base/types.h"
#include "geometry/box_tree.h"
#include "geometry/closest.h"

namespace toile {

/// How often the mesh winds around p: 1 inside and 0 outside of a closed, outward oriented surface; 2 where two such
/// parts overlap; fractions near holes. Owns copies of the mesh.
class WindingNumber {
public:
    WindingNumber(const Vertices& V, const Faces& F);
    double at(const Vec3& p) const;
    bool inside(const Vec3& p) const { return at(p) > 0.5; }

private:
    struct Moments {
        Vec3 centre = Vec3::Zero();  ///< area-weighted mean of face centres
        Vec3 normal = Vec3::Zero();  ///< sum of area vectors [m^2]
        Mat3 spread = Mat3::Zero();  ///< sum of area vector x (face centre - centre)' [m^3]
        double radius = 0;           ///< of a ball about the centre that holds the node's faces [m]
    };
    double solid_angle(const Vec3& p, int face) const;

    Vertices V_;
    Faces F_;
    BoxTree tree_;
    std::vector<Moments> moments_;
};

Vector winding_numbers(const Vertices& points, const WindingNumber& winding);  ///< parallel

/// Distance to the surface [m], negative inside (winding number above 1/2). Where the mesh overlaps itself the distance
/// is to the nearest face, which may lie inside the solid.
Vector signed_distance(const Vertices& points, const SurfaceIndex& index, const WindingNumber& winding);

}  // namespace toile
