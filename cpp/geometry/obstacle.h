// A surface that other things must stay outside of: where a point stands towards it and which way is out.
#pragma once
#include <memory>
#include <vector>

#include "base/types.h"
#include "geometry/closest.h"
#include "geometry/winding.h"

namespace toile {

/// What a face list says about sides, without positions: computed once for a sequence.
struct SideTopology {
    explicit SideTopology(const Faces& F);
    bool closed = true;             ///< no edge with one face only
    Faces across;                   ///< (m,3) the face beyond edge (c, c+1); -1 at a rim or a non-manifold edge
    std::vector<char> rim;          ///< per vertex, up to the largest index
};

enum class Side { inside, outside, unknown };

struct Probe {
    double distance = 0;            ///< [m], negative inside
    Vec3 point = Vec3::Zero();      ///< the closest point of the surface [m]
    Vec3 outward = Vec3::Zero();    ///< unit; from the surface outwards through the probe, or the surface's normal on it
    bool constrained = false;       ///< false: the surface gives no direction here (beyond a rim, in an overlap, too deep)
    bool inside() const { return distance < 0; }
};

/// Closed surfaces tell inside by winding numbers (either orientation), open ones by the normal at the closest point:
/// well beyond a rim, or deeper than `max_depth`, an open surface has no inside.
class Obstacle {
public:
    Obstacle(const Vertices& V, const Faces& F, const SideTopology& topology, double max_depth);

    Probe probe(const Vec3& p) const;
    std::vector<Probe> probe_each(const Vertices& points) const;  ///< parallel
    /// The same, where `known` are the probes of the points' former places: a point whose step is covered by the two
    /// empty balls around its ends has crossed no surface, and its winding number is not asked for again.
    std::vector<Probe> probe_each(const Vertices& points, const Vertices& former, const std::vector<Probe>& known) const;
    /// Probes by normals alone, as for an open surface but at any depth: several times quicker, and wrong where a closed
    /// surface overlaps itself. Points whose `known` probe was unconstrained stay so.
    std::vector<Probe> probe_each_quickly(const Vertices& points, const std::vector<Probe>& known) const;
    bool closed() const { return winding_ != nullptr; }
    /// Free length from the surface at the probe outwards, at most `reach` [m].
    double room(const Probe& probe, double reach) const;

private:
    template <class SideAt>
    Probe probe(const Vec3& p, SideAt&& side_at) const;
    Side side(const Vec3& p) const;  ///< by the winding number; unknown for an open surface
    Vec3 pseudo_normal(const SurfacePoint& s) const;
    bool on_rim(const SurfacePoint& s) const;

    const SideTopology& topology_;
    double max_depth_;
    double orientation_ = 1;        ///< -1: a closed surface whose faces look inwards
    double size_ = 1;               ///< diagonal of the box [m]
    SurfaceIndex index_;
    std::unique_ptr<WindingNumber> winding_;
    Vertices face_normal_, vertex_normal_;
};

}  // namespace toile
