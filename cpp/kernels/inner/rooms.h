// The room between body and cloth in a frame, and what all frames say of it.
#pragma once
#include <cstdint>
#include <limits>
#include <vector>

#include "geometry/closest.h"
#include "kernels/inner.h"

namespace toile {

constexpr double kNone = std::numeric_limits<double>::infinity();
constexpr int kRoomNodes = 513;    // from -reach to reach
constexpr double kRoomUnit = 256;  // counts of one frame

using Indexes = std::vector<SurfaceIndex>;

Indexes index_garments(const std::vector<InnerGarment>& garments);

/// Per vertex, how far along its normal the nearest cloth lies (negative: the vertex is outside it); infinity where
/// none is in reach, or where the nearest lies beside the vertex, beyond a hem. The innermost garment counts.
Vector cloth_room(const Vertices& Y, const Vertices& normals, const Vector& skin, const Indexes& garments,
                  double reach);

/// (n,) how far along its normal cloth may draw a vertex of the body V (n,3): inwards by the `share` of how thick it is
/// there, along a ray (the diameter of Shapira et al. 2008); -infinity of `skin` as a whole. Drawn deeper, a limb would
/// fold through itself.
Vector deepest(const Vertices& V, const Faces& F, const Vertices& normals, const Vector& skin, double share);

/// Counts a frame's room at the two nodes beside it, by nearness: the quantile stays continuous in the room, and whole
/// numbers add up to the same bits in any order.
void count_room(double room, double reach, std::uint32_t* nodes);

/// The q-quantile of counted rooms, linear between the ranks of the nodes' middles, to within a node; infinity without
/// any.
double room_quantile(const std::uint32_t* nodes, double reach, double q);

/// Counted rooms: in how many frames, their mean, and the sum of squares about it.
struct RoomSpread {
    double frames = 0, mean = 0, squares = 0;
};
RoomSpread room_spread(const std::uint32_t* nodes, double reach);

void check_inner_sums(const InnerSums& sums, Eigen::Index n);

}  // namespace toile
