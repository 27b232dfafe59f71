#include "geometry/obstacle.h"

#include <algorithm>
#include <cmath>
#include <tuple>

#include "base/parallel.h"
#include "geometry/laplacian.h"

namespace toile {

namespace {

constexpr double on_edge = 1e-12;  // a barycentric coordinate this small lies on the edge

double signed_volume(const Vertices& V, const Faces& F) {
    const Vec3 origin = V.row(F(0, 0));
    double six = 0;
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const Vec3 a = V.row(F(f, 0)).transpose() - origin, b = V.row(F(f, 1)).transpose() - origin,
                   c = V.row(F(f, 2)).transpose() - origin;
        six += a.dot(b.cross(c));
    }
    return six / 6;
}

/// Normals weighted by the angle at the vertex: the sign of a point whose closest feature is the vertex follows them
/// (Baerentzen and Aanaes 2005).
Vertices angle_weighted_normals(const Vertices& V, const Faces& F, const Vertices& face_normal) {
    Vertices normal = Vertices::Zero(V.rows(), 3);
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const Vec3 a = V.row(F(f, c)), u = V.row(F(f, (c + 1) % 3)).transpose() - a,
                       w = V.row(F(f, (c + 2) % 3)).transpose() - a;
            normal.row(F(f, c)) += std::atan2(u.cross(w).norm(), u.dot(w)) * face_normal.row(f);
        }
    normal.rowwise().normalize();
    return normal;
}

/// f(point, row) for every row, in parallel.
template <class Function>
std::vector<Probe> each(const Vertices& points, Function&& f) {
    std::vector<Probe> out(static_cast<std::size_t>(points.rows()));
    parallel_for(
        points.rows(),
        [&](std::int64_t i) { out[static_cast<std::size_t>(i)] = f(Vec3(points.row(i)), static_cast<std::size_t>(i)); }, 64);
    return out;
}

}  // namespace

SideTopology::SideTopology(const Faces& F) : across(Faces::Constant(F.rows(), 3, -1)) {
    struct Side {
        int low, high, face, corner;
    };
    std::vector<Side> sides;
    sides.reserve(static_cast<std::size_t>(3 * F.rows()));
    for (int f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, c), j = F(f, (c + 1) % 3);
            if (i != j) sides.push_back({std::min(i, j), std::max(i, j), f, c});
        }
    std::sort(sides.begin(), sides.end(), [](const Side& a, const Side& b) {
        return std::tie(a.low, a.high, a.face, a.corner) < std::tie(b.low, b.high, b.face, b.corner);
    });
    rim.assign(F.rows() > 0 ? static_cast<std::size_t>(F.maxCoeff()) + 1 : 0, 0);
    for (std::size_t i = 0, j; i < sides.size(); i = j) {
        for (j = i; j < sides.size() && sides[j].low == sides[i].low && sides[j].high == sides[i].high;) ++j;
        if (j - i == 1) {
            closed = false;
            rim[static_cast<std::size_t>(sides[i].low)] = rim[static_cast<std::size_t>(sides[i].high)] = 1;
        } else if (j - i == 2) {
            across(sides[i].face, sides[i].corner) = sides[i + 1].face;
            across(sides[i + 1].face, sides[i + 1].corner) = sides[i].face;
        }
    }
}

Obstacle::Obstacle(const Vertices& V, const Faces& F, const SideTopology& topology, double max_depth)
    : topology_(topology), max_depth_(max_depth), index_(V, F), face_normal_(face_normals(V, F)) {
    vertex_normal_ = angle_weighted_normals(V, F, face_normal_);
    Box box;
    for (Eigen::Index f = 0; f < F.rows(); ++f) box.extend(toile::face_box(V, F, f));  // no unreferenced vertex counts
    size_ = box.diagonal().norm();
    if (!topology.closed) return;
    orientation_ = signed_volume(V, F) < 0 ? -1 : 1;
    winding_ = std::make_unique<WindingNumber>(V, F);
}

bool Obstacle::on_rim(const SurfacePoint& s) const {
    if (topology_.closed) return false;
    const auto face = index_.faces().row(s.face);
    for (int c = 0; c < 3; ++c) {
        if (s.barycentric[c] > 1 - on_edge) return topology_.rim[static_cast<std::size_t>(face[c])] != 0;
        const bool between = s.barycentric[(c + 2) % 3] < on_edge;
        const bool rim_edge = topology_.across(s.face, c) < 0 && topology_.rim[static_cast<std::size_t>(face[c])] &&
                              topology_.rim[static_cast<std::size_t>(face[(c + 1) % 3])];
        if (between && rim_edge) return true;
    }
    return false;
}

Vec3 Obstacle::pseudo_normal(const SurfacePoint& s) const {
    Vec3 n = face_normal_.row(s.face);
    for (int c = 0; c < 3; ++c) {
        if (s.barycentric[c] > 1 - on_edge) return vertex_normal_.row(index_.faces()(s.face, c)) * orientation_;
        const int beyond = topology_.across(s.face, c);
        if (s.barycentric[(c + 2) % 3] < on_edge && beyond >= 0) n += face_normal_.row(beyond).transpose();
    }
    return n.normalized() * orientation_;
}

/// `side(distance)` says on which side p lies, `distance` from the surface; unknown leaves it to the normal there.
template <class SideAt>
Probe Obstacle::probe(const Vec3& p, SideAt&& side_at) const {
    const SurfacePoint s = index_.closest(p);
    const Vec3 normal = pseudo_normal(s), offset = p - s.point;
    const bool sided = normal.squaredNorm() > 0.5;  // false: the closest face has no area, hence no side
    const Side side = side_at(s.distance);
    const bool behind = sided || side == Side::unknown ? offset.dot(normal) < 0 : side == Side::inside;
    Probe out;
    out.point = s.point;
    // Too near for a direction of its own (1e-9 of the size), the probe takes the surface's.
    out.outward = s.distance > 1e-9 * size_ ? Vec3(offset / (behind ? -s.distance : s.distance)) : normal;
    if (side != Side::unknown) {
        out.distance = side == Side::inside ? -s.distance : s.distance;
        out.constrained = (side == Side::inside) == behind;  // else inside another part of a body that overlaps itself
    } else {
        // Beyond a rim there is neither in nor out, but within 45 degrees of the rim's normal it still reaches.
        const bool beyond = on_rim(s) && std::abs(offset.dot(normal)) < std::sqrt(0.5) * s.distance;
        out.constrained = sided && !beyond && !(behind && !winding_ && s.distance > max_depth_);
        out.distance = behind && out.constrained ? -s.distance : s.distance;
    }
    if (!(out.outward.squaredNorm() > 0.5)) out.constrained = false;
    return out;
}

Side Obstacle::side(const Vec3& p) const {
    if (!winding_) return Side::unknown;
    return orientation_ * winding_->at(p) > 0.5 ? Side::inside : Side::outside;
}

Probe Obstacle::probe(const Vec3& p) const {
    return probe(p, [&](double) { return side(p); });
}

std::vector<Probe> Obstacle::probe_each(const Vertices& points) const {
    return each(points, [&](const Vec3& p, std::size_t) { return probe(p); });
}

std::vector<Probe> Obstacle::probe_each(const Vertices& points, const Vertices& former, const std::vector<Probe>& known) const {
    return each(points, [&](const Vec3& p, std::size_t k) {
        const double step = (p - former.row(static_cast<Eigen::Index>(k)).transpose()).norm();
        return probe(p, [&](double distance) {
            const bool crossed_nothing = step + 1e-6 * size_ < std::abs(known[k].distance) + distance;  // float32 distances
            if (!winding_ || !crossed_nothing) return side(p);
            return known[k].inside() ? Side::inside : Side::outside;
        });
    });
}

std::vector<Probe> Obstacle::probe_each_quickly(const Vertices& points, const std::vector<Probe>& known) const {
    return each(points, [&](const Vec3& p, std::size_t k) {
        Probe out = probe(p, [](double) { return Side::unknown; });
        out.constrained = out.constrained && (!winding_ || known[k].constrained);
        return out;
    });
}

double Obstacle::room(const Probe& probe, double reach) const {
    const double start = std::max(0.02 * reach, 1e-6 * size_);  // clear of the face that it leaves, in float32
    if (start >= reach) return reach;
    const RayHit hit = index_.first_hit(probe.point + start * probe.outward, probe.outward, 0, reach - start);
    return hit.face < 0 ? reach : std::clamp(start + hit.distance, 0.0, reach);
}

}  // namespace toile
