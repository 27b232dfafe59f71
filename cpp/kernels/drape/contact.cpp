#include "kernels/drape/contact.h"

#include <algorithm>
#include <cmath>

#include "base/parallel.h"

namespace toile {

void Contact::place(const Vertices& body_V) {
    from_ = to_ = body_V;
    stride_ = way_ = 0;
    near_.clear();
    body_.move(body_V);
}

void Contact::aim(const Vertices& body_V) {
    to_ = body_V;
    stride_ = (to_ - from_).rowwise().norm().maxCoeff();
}

void Contact::look(const Vertices& x, const Vector& w, const Vector& reach, double at) {
    const bool first = near_.empty();
    near_.resize(static_cast<std::size_t>(x.rows()));
    now_ = from_ + at * (to_ - from_);
    body_.follow(now_);
    const double way = way_ + at * stride_;
    parallel_for(x.rows(), [&](std::int64_t i) {
        Near& near = near_[static_cast<std::size_t>(i)];
        near.room -= reach[i];
        if (w[i] == 0 || (!first && near.room > 0)) return;
        const Vec3 p = x.row(i);
        Probe probe = body_.probe(p, near.face);
        if (first && body_.closed())
            body_.decide(probe, body_.parts(p));
        else if (!first && strayed(near, probe, (p - near.seen).norm() + way - near.way))
            probe.turn();
        near.seen = p;
        near.way = way;
        near.face = probe.face;
        near.bound = probe.constrained && probe.face >= 0;
        near.distance = near.bound ? probe.distance : probe.nearest;
        near.room = near.distance - margin_ - reach[i];
        near.outward = probe.outward;
        if (near.face < 0) return;
        const BoxTree::Triangle& t = body_.triangle(near.face);
        near.barycentric = closest_on_triangle(probe.point, t.a, t.b, t.c).barycentric;
    });
}

/// The distance from the body, negative inside, changes by no more than vertex and body move. Where the body folds through
/// itself the normal at the closest point may look inwards, and says otherwise.
bool Contact::strayed(const Near& near, const Probe& probe, double moved) {
    constexpr double rounding = 1e-3;
    const bool crossed = near.bound && probe.constrained && (probe.distance < 0) != (near.distance < 0);
    return crossed && std::abs(probe.distance - near.distance) > (1 + rounding) * moved;
}

void Contact::arrive() {
    way_ += stride_;
    stride_ = 0;
    from_ = to_;
}

Vec3 Contact::carried(const Near& near, double at) const {
    Vec3 point = Vec3::Zero();
    for (int c = 0; c < 3; ++c) {
        const int v = F_(near.face, c);
        point += near.barycentric[c] * ((1 - at) * from_.row(v) + at * to_.row(v)).transpose();
    }
    return point;
}

void Contact::push(Vertices& x, const Vertices& before, double from, double to) {
    parallel_for(x.rows(), [&](std::int64_t i) {
        Near& near = near_[static_cast<std::size_t>(i)];
        near.pushed = false;
        if (!near.bound || near.room > 0) return;
        const Vec3 point = carried(near, to), p = x.row(i);
        const double depth = margin_ - (p - point).dot(near.outward);
        if (!(depth > 0)) return;
        near.pushed = true;
        const Vec3 slid = p - Vec3(before.row(i)) - (point - carried(near, from));
        const Vec3 along = slid - slid.dot(near.outward) * near.outward;
        const double length = along.norm(), most = friction_ * depth;  // Coulomb: the push is the normal impulse
        const Vec3 kept = length > most ? Vec3(along * (most / length)) : along;
        x.row(i) = p + depth * near.outward - kept;
    });
}

void Contact::take_bounce(Vertices& v, double from, double to, double h) const {
    parallel_for(v.rows(), [&](std::int64_t i) {
        const Near& near = near_[static_cast<std::size_t>(i)];
        if (!near.pushed) return;
        const Vec3 body = (carried(near, to) - carried(near, from)) / h;
        const double leaving = (Vec3(v.row(i)) - body).dot(near.outward);
        if (leaving > 0) v.row(i) -= leaving * near.outward;
    });
}

int Contact::contacts() const {
    return static_cast<int>(std::count_if(near_.begin(), near_.end(), [](const Near& n) { return n.pushed; }));
}

int Contact::inside() const {
    return static_cast<int>(
        std::count_if(near_.begin(), near_.end(), [](const Near& n) { return n.bound && n.distance < 0; }));
}

}  // namespace toile
