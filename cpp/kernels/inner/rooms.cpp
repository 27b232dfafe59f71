#include "kernels/inner/rooms.h"

#include <algorithm>
#include <cmath>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

namespace {

constexpr double kSkinDepth = 1e-3;  // [m] within which a ray meets the faces that it starts on

double node_room(int node, double reach) { return reach * (2.0 * node / (kRoomNodes - 1) - 1); }

}  // namespace

Indexes index_garments(const std::vector<InnerGarment>& garments) {
    Indexes out;
    for (const InnerGarment& g : garments) out.emplace_back(g.V, g.F);
    return out;
}

Vector cloth_room(const Vertices& Y, const Vertices& normals, const Vector& skin, const Indexes& garments,
                  double reach) {
    Vector room = Vector::Constant(Y.rows(), kNone);
    parallel_for(Y.rows(), [&](std::int64_t v) {
        if (skin[v] >= 1) return;
        for (const SurfaceIndex& garment : garments) {
            const SurfacePoint hit = garment.closest(Vec3(Y.row(v)), reach);
            if (hit.face < 0) continue;
            const Vec3 gap = hit.point - Y.row(v).transpose();
            const double along = gap.dot(Vec3(normals.row(v)));
            if (hit.distance < 1e-3 || std::abs(along) > 0.7 * hit.distance) room[v] = std::min(room[v], along);
        }
    });
    return room;
}

Vector deepest(const Vertices& V, const Faces& F, const Vertices& normals, const Vector& skin, double share) {
    Vector out = Vector::Constant(V.rows(), -kNone);
    const SurfaceIndex body(V, F);
    parallel_for(V.rows(), [&](std::int64_t v) {
        const Vec3 inwards = -normals.row(v);
        if (skin[v] >= 1 || inwards.squaredNorm() < 0.5) return;  // a vertex without faces has no normal
        const RayHit far = body.first_hit(V.row(v), inwards, kSkinDepth);
        if (far.face >= 0) out[v] = -share * far.distance;
    });
    return out;
}

void count_room(double room, double reach, std::uint32_t* nodes) {
    const double at = std::clamp((room / reach + 1) * (kRoomNodes - 1) / 2, 0.0, kRoomNodes - 1.0);
    const int low = std::min(static_cast<int>(at), kRoomNodes - 2);
    const auto beyond = static_cast<std::uint32_t>(std::lround((at - low) * kRoomUnit));
    nodes[low] += static_cast<std::uint32_t>(kRoomUnit) - beyond;
    nodes[low + 1] += beyond;
}

double room_quantile(const std::uint32_t* nodes, double reach, double q) {
    double total = 0;
    for (int j = 0; j < kRoomNodes; ++j) total += nodes[j];
    if (total <= 0) return kNone;
    const double rank = q * (total - kRoomUnit) + kRoomUnit / 2;
    double before = 0, last_rank = 0, last = kNone;
    for (int j = 0; j < kRoomNodes; ++j) {
        if (nodes[j] == 0) continue;
        const double here = node_room(j, reach), middle = before + 0.5 * nodes[j];
        if (middle >= rank)
            return std::isfinite(last) ? last + (rank - last_rank) / (middle - last_rank) * (here - last) : here;
        before += nodes[j];
        last_rank = middle;
        last = here;
    }
    return last;
}

RoomSpread room_spread(const std::uint32_t* nodes, double reach) {
    RoomSpread out;
    for (int j = 0; j < kRoomNodes; ++j) {
        if (nodes[j] == 0) continue;
        const double count = nodes[j] / kRoomUnit, miss = node_room(j, reach) - out.mean;
        out.frames += count;  // Welford's update
        out.mean += count / out.frames * miss;
        out.squares += count * miss * (node_room(j, reach) - out.mean);
    }
    return out;
}

void check_inner_sums(const InnerSums& sums, Eigen::Index n) {
    require(sums.position.rows() == n && sums.weight.size() == n && sums.skin.size() == n && sums.room.rows() == n &&
                sums.room.cols() == kRoomNodes,
            "inner: sums of another body model");
}

InnerSums& InnerSums::operator+=(const InnerSums& other) {
    check_inner_sums(*this, other.position.rows());
    check_inner_sums(other, position.rows());
    position += other.position;
    weight += other.weight;
    skin += other.skin;
    room += other.room;
    frames += other.frames;
    return *this;
}

}  // namespace toile
