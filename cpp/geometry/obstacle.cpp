#include "geometry/obstacle.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/parallel.h"

namespace toile {

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr int no_face = -1, border_side = -2;  // across a non-manifold edge, and across none
constexpr double on_edge = 1e-12;              // a barycentric coordinate this small lies on the edge
constexpr double touching = 1e-9;              // of the size: a point this near lies on the surface

Vec3 unit_or_zero(const Vec3& v) {
    const double length = v.norm();
    return length > 0 ? Vec3(v / length) : Vec3::Zero();
}

/// Zero where the height is the rounding of the corners' places: such a face looks anywhere.
Vec3 normal_of(const BoxTree::Triangle& t) {
    const Vec3 ab = t.b - t.a, ac = t.c - t.a, n = ab.cross(ac);
    const double longest = std::max({ab.norm(), ac.norm(), (ac - ab).norm()});
    const double place = std::max({t.a.norm(), t.b.norm(), t.c.norm()});
    return n.norm() > 4e-15 * place * longest ? unit_or_zero(n) : Vec3::Zero();
}

/// Length along the unit direction d from p to the triangle; `reach` where it is missed.
double hit(const Vec3& p, const Vec3& d, double reach, const BoxTree::Triangle& t) {
    const Vec3 u = t.b - t.a, v = t.c - t.a, n = u.cross(v), s = p - t.a;
    const double slope = n.dot(d);
    if (slope == 0) return reach;
    const Vec3 q = s.cross(d) / slope;
    const double x = -v.dot(q), y = u.dot(q), length = -n.dot(s) / slope;
    return x >= 0 && y >= 0 && x + y <= 1 && length >= 0 ? std::min(length, reach) : reach;
}

}  // namespace

Obstacle::Obstacle(Faces F, double max_depth)
    : F_(std::move(F)), max_depth_(max_depth), across_(Faces::Constant(F_.rows(), 3, no_face)),
      border_(static_cast<std::size_t>(F_.maxCoeff()) + 1, 0), faces_of_(vertex_faces(F_, F_.maxCoeff() + 1)) {
    constexpr int block = 512;  // vertices, in parallel
    parallel_for((faces_of_.size() + block - 1) / block, [&](std::int64_t b) {
        const int begin = static_cast<int>(b) * block;
        pair_sides(begin, std::min(begin + block, faces_of_.size()));
    }, 1);
    for (Eigen::Index f = 0; f < F_.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            if (across_(f, c) != border_side) continue;
            closed_ = false;
            border_[static_cast<std::size_t>(F_(f, c))] = border_[static_cast<std::size_t>(F_(f, (c + 1) % 3))] = 1;
        }
}

/// What lies across the edges from these vertices to greater ones.
void Obstacle::pair_sides(int begin, int end) {
    struct Side {
        int to, face, corner;
    };
    std::vector<Side> sides;
    for (int v = begin; v < end; ++v) {
        sides.clear();
        for (int k = faces_of_.start[static_cast<std::size_t>(v)]; k < faces_of_.start[static_cast<std::size_t>(v) + 1];
             ++k) {
            const int f = faces_of_.index[static_cast<std::size_t>(k)];
            for (int c = 0; c < 3; ++c) {
                const int i = F_(f, c), j = F_(f, (c + 1) % 3);
                if (i != j && std::min(i, j) == v) sides.push_back({std::max(i, j), f, c});
            }
        }
        for (std::size_t a = 0; a < sides.size(); ++a) {
            if (sides[a].to < 0) continue;
            int others = 0, mate = -1;
            for (std::size_t b = a + 1; b < sides.size(); ++b) {
                if (sides[b].to != sides[a].to) continue;
                sides[b].to = -1;  // seen
                mate = static_cast<int>(b), ++others;
            }
            if (others == 0) across_(sides[a].face, sides[a].corner) = border_side;
            if (others != 1) continue;
            const Side& other = sides[static_cast<std::size_t>(mate)];
            across_(sides[a].face, sides[a].corner) = other.face;
            across_(other.face, other.corner) = sides[a].face;
        }
    }
}

void Obstacle::follow(const Vertices& V) {
    if (tree_)
        tree_->refit(V, F_);
    else
        tree_ = std::make_unique<BoxTree>(V, F_);
    size_ = tree_->nodes()[0].box.diagonal().norm();
}

void Obstacle::move(const Vertices& V) {
    follow(V);
    if (!closed_) return;
    winding_ = std::make_unique<WindingMoments>(*tree_);
    orientation_ = winding_->volume() < 0 ? -1 : 1;
    hollow_ = std::abs(winding_->volume()) < 1e-12 * std::pow(size_, 3);
}

bool Obstacle::on_border(const SurfacePoint& s) const {
    if (closed_) return false;
    const auto face = F_.row(s.face);
    for (int c = 0; c < 3; ++c) {
        if (s.barycentric[c] > 1 - on_edge) return border_[static_cast<std::size_t>(face[c])] != 0;
        const bool between = s.barycentric[(c + 2) % 3] < on_edge;
        if (between && across_(s.face, c) == border_side) return true;
    }
    return false;
}

Vec3 Obstacle::face_normal(int face) const { return normal_of(triangle(face)); }

/// Weighted by the angle at the vertex: the sign of a point whose closest feature is the vertex follows it
/// (Baerentzen and Aanaes 2005).
Vec3 Obstacle::vertex_normal(int vertex) const {
    Vec3 sum = Vec3::Zero();
    const auto v = static_cast<std::size_t>(vertex);
    for (int k = faces_of_.start[v]; k < faces_of_.start[v + 1]; ++k) {
        const int f = faces_of_.index[static_cast<std::size_t>(k)];
        const BoxTree::Triangle& t = triangle(f);
        const Vec3* corners[3] = {&t.a, &t.b, &t.c};
        const Vec3 normal = normal_of(t);
        for (int c = 0; c < 3; ++c) {
            if (F_(f, c) != vertex) continue;
            const Vec3 u = *corners[(c + 1) % 3] - *corners[c], w = *corners[(c + 2) % 3] - *corners[c];
            sum += std::atan2(u.cross(w).norm(), u.dot(w)) * normal;
        }
    }
    return unit_or_zero(sum);
}

Vec3 Obstacle::pseudo_normal(const SurfacePoint& s) const {
    Vec3 n = face_normal(s.face);
    const bool thin = n.isZero(0);  // all its sides are one
    for (int c = 0; c < 3; ++c) {
        if (s.barycentric[c] > 1 - on_edge) return vertex_normal(F_(s.face, c)) * orientation_;
        const int beyond = across_(s.face, c);
        if ((thin || s.barycentric[(c + 2) % 3] < on_edge) && beyond >= 0) n += face_normal(beyond);
    }
    return unit_or_zero(n) * orientation_;
}

Probe Obstacle::probe(const Vec3& p, int guess) const {
    const SurfacePoint s = tree_->closest(p, guess);
    if (s.face < 0) return {.distance = infinity, .nearest = infinity};  // squares overflowed
    const Vec3 normal = pseudo_normal(s), offset = p - s.point;
    const bool behind = offset.dot(normal) < 0;
    Probe out;
    out.nearest = s.distance;
    out.face = s.face;
    out.point = s.point;
    out.sided = normal.squaredNorm() > 0.5;
    out.behind = behind;
    // Too near for a direction of its own, the probe takes the surface's.
    out.outward = s.distance > touching * size_ ? Vec3(offset / (behind ? -s.distance : s.distance)) : normal;
    // Beyond a border there is neither in nor out, but within 45 degrees of the border's normal it still reaches.
    const bool beyond = on_border(s) && std::abs(offset.dot(normal)) < std::sqrt(0.5) * s.distance;
    out.constrained = out.sided && !beyond && !(behind && !closed_ && s.distance > max_depth_);
    out.distance = behind && out.constrained ? -s.distance : s.distance;
    if (!(out.outward.squaredNorm() > 0.5)) out.constrained = false;
    return out;
}

int Obstacle::parts(const Vec3& p) const {
    return static_cast<int>(std::lround(orientation_ * winding_->at(*tree_, p)));
}

/// Behind the closest face lies one part more than before it. So a probe inside comes out through that face where it is
/// behind it, or, where the parts are turned inside out, before it; else it is inside another part than the nearest.
void Obstacle::decide(Probe& probe, int parts) const {
    const bool inside = parts != 0, leads_out = !inside || !probe.sided || probe.behind == (parts > 0);
    if ((inside && leads_out) != probe.inside() && probe.nearest > touching * size_) probe.outward = -probe.outward;
    probe.constrained = leads_out && probe.outward.squaredNorm() > 0.5;
    probe.distance = inside ? -probe.nearest : probe.nearest;
}

int Obstacle::turned(const Probe& probe, int parts) {
    if (!probe.sided || (parts != 0 && probe.behind != (parts > 0))) return -1;
    return (parts != 0) != probe.behind;
}

bool Obstacle::pass_through(const Vec3& p, Probe& probe) const {
    std::vector<std::pair<double, int>> hits;  // length, face
    tree_->visit_overlapping(Box(p).extend(Vec3(p + max_depth_ * probe.outward)), [&](int slot) {
        const double length = hit(p, probe.outward, max_depth_, tree_->triangle(slot));
        if (length < max_depth_) hits.emplace_back(length, tree_->order()[static_cast<std::size_t>(slot)]);
    });
    std::sort(hits.begin(), hits.end());
    int left = parts(p);
    const int sign = left < 0 ? -1 : 1;
    for (const auto& [length, face] : hits) {
        const Vec3 normal = face_normal(face) * orientation_;
        if (normal.isZero(0)) continue;
        left += normal.dot(probe.outward) > 0 ? -1 : 1;
        if (sign * left > 0) continue;
        probe.point = p + length * probe.outward;
        probe.outward = sign * normal;
        probe.distance = -length;
        probe.face = face;
        probe.constrained = true;
        return true;
    }
    return false;
}

}  // namespace toile
