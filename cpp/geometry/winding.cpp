#include "geometry/winding.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/parallel.h"

namespace toile {

namespace {
// A node is summed by its moments from beyond `far` radii; the winding number is then 0.02 off on a body, 0.04 on balls.
constexpr double far = 2.5;
}  // namespace

WindingNumber::WindingNumber(const Vertices& V, const Faces& F) : V_(V), F_(F), tree_(V, F) {
    const auto& nodes = tree_.nodes();
    moments_.resize(nodes.size());
    parallel_for(static_cast<std::int64_t>(nodes.size()), [&](std::int64_t k) {
        const BoxTree::Node& node = nodes[static_cast<std::size_t>(k)];
        Moments& s = moments_[static_cast<std::size_t>(k)];
        const Vec3 origin = node.box.center();  // sums of small offsets, far from the origin too
        double area = 0;
        Vec3 offset = Vec3::Zero();
        for (int i = node.begin; i < node.end; ++i) {
            const int f = tree_.order()[static_cast<std::size_t>(i)];
            const Vec3 a = V_.row(F_(f, 0)), b = V_.row(F_(f, 1)), c = V_.row(F_(f, 2));
            const Vec3 n = (b - a).cross(c - a) / 2, x = ((a - origin) + (b - origin) + (c - origin)) / 3;
            s.normal += n;
            s.spread += n * x.transpose();
            offset += n.norm() * x;
            area += n.norm();
        }
        if (area > 0) offset /= area;
        s.centre = origin + offset;
        s.spread -= s.normal * offset.transpose();
        double square = 0;
        for (int i = node.begin; i < node.end; ++i)
            for (int c = 0; c < 3; ++c)
                square = std::max(square, (V_.row(F_(tree_.order()[static_cast<std::size_t>(i)], c)).transpose() - s.centre).squaredNorm());
        s.radius = std::sqrt(square);
    });
}

// Van Oosterom and Strackee 1983, equation (8).
double WindingNumber::solid_angle(const Vec3& p, int face) const {
    const Vec3 a = V_.row(F_(face, 0)).transpose() - p, b = V_.row(F_(face, 1)).transpose() - p,
               c = V_.row(F_(face, 2)).transpose() - p;
    const double la = a.norm(), lb = b.norm(), lc = c.norm();
    const double y = a.dot(b.cross(c));
    const double x = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    return y == 0 && x == 0 ? 0 : 2 * std::atan2(y, x);
}

double WindingNumber::at(const Vec3& p) const {
    double sum = 0;
    int stack[64], top = 0;
    if (!moments_.empty()) stack[top++] = 0;
    while (top > 0) {
        const int self = stack[--top];
        const BoxTree::Node& node = tree_.nodes()[static_cast<std::size_t>(self)];
        const Moments& s = moments_[static_cast<std::size_t>(self)];
        const Vec3 r = s.centre - p;
        const double distance = r.norm();
        if (distance > far * s.radius) {
            const double d2 = distance * distance, d3 = d2 * distance;
            sum += s.normal.dot(r) / d3 + s.spread.trace() / d3 - 3 * r.dot(s.spread * r) / (d3 * d2);
        } else if (node.leaf()) {
            for (int k = node.begin; k < node.end; ++k) sum += solid_angle(p, tree_.order()[static_cast<std::size_t>(k)]);
        } else {
            stack[top++] = node.right;
            stack[top++] = self + 1;
        }
    }
    return sum / (4 * std::numbers::pi);
}

Vector winding_numbers(const Vertices& points, const WindingNumber& winding) {
    Vector out(points.rows());
    parallel_for(points.rows(), [&](std::int64_t i) { out[i] = winding.at(points.row(i)); }, 64);
    return out;
}

Vector signed_distance(const Vertices& points, const SurfaceIndex& index, const WindingNumber& winding) {
    Vector out(points.rows());
    parallel_for(
        points.rows(),
        [&](std::int64_t i) {
            const Vec3 p = points.row(i);
            const double distance = index.closest(p).distance;
            out[i] = winding.inside(p) ? -distance : distance;
        },
        64);
    return out;
}

}  // namespace toile
