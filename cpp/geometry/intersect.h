// Which triangles meet, decided by exact predicates: no tolerance, no rounding.
#pragma once
#include "../base/types.h"
#include "box_tree.h"

namespace toile {

/// Do the closed triangles share a point? Touching counts. Exact; triangles of no area are segments or points.
bool triangles_intersect(const Vec3& a0, const Vec3& a1, const Vec3& a2, const Vec3& b0, const Vec3& b1,
                         const Vec3& b2);

/// Faces (f of F1, g of F2) that intersect, sorted by f, then g: (k,2).
Edges intersecting_pairs(const Vertices& V1, const Faces& F1, const Vertices& V2, const Faces& F2);
Edges meeting_faces(const BoxTree& first, const BoxTree& second);  ///< the same; hidden faces meet nothing

/// Faces (f < g) of one mesh that intersect and share no vertex index, sorted: (k,2).
Edges self_intersections(const Vertices& V, const Faces& F);

}  // namespace toile
