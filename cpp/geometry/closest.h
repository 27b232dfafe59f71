// Closest points and rays on a triangle mesh: Embree finds the face in float32 on a centred, scaled copy, the point is
// recomputed in double.
#pragma once
#include <memory>

#include "../base/types.h"

namespace toile {

struct SurfacePoint {
    int face = -1;              ///< -1: none within the radius
    Vec3 point = Vec3::Zero();  ///< [m]
    Vec3 barycentric = Vec3::Zero();
    double distance = 0;  ///< [m]
};

struct RayHit {
    int face = -1;        ///< -1: no hit
    double distance = 0;  ///< along the unit direction [m]
};

/// Closest point on one triangle, with its barycentric coordinates (Ericson 2005, section 5.1.5).
SurfacePoint closest_on_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c);

/// Owns a copy of the mesh. Queries are const and safe from several threads.
class SurfaceIndex {
public:
    SurfaceIndex(const Vertices& V, const Faces& F);
    ~SurfaceIndex();
    SurfaceIndex(SurfaceIndex&&) noexcept;
    SurfaceIndex& operator=(SurfaceIndex&&) noexcept;

    /// A face near the point may be guessed (-1: none): it saves time and changes nothing.
    SurfacePoint closest(const Vec3& p, double radius = 1e30, int guess = -1) const;
    /// In parallel; `guesses` are as many as points, or none.
    std::vector<SurfacePoint> closest_each(const Vertices& points, double radius = 1e30,
                                           const Indices& guesses = {}) const;
    /// The points nearest to `points` that are reached from the faces `start`, over whatever side or corner comes nearer until
    /// none does: on the same sheet, however near another one lies. In parallel.
    std::vector<SurfacePoint> reached_each(const Vertices& points, const Indices& start) const;
    RayHit first_hit(const Vec3& origin, const Vec3& direction, double from = 0, double to = 1e30) const;
    bool occluded(const Vec3& origin, const Vec3& direction, double from = 0, double to = 1e30) const;

    /// How many of `count` <= packet rays from one point, along unit directions, meet a face within `to`.
    int occluded_of(const Vec3& origin, const Vec3* directions, int count, double to = 1e30) const;
    static constexpr int packet = 8;

    double diagonal() const;  ///< of the box of referenced vertices [m]
    const Vertices& vertices() const;
    const Faces& faces() const;

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace toile
