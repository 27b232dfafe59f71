#include "kernels/nricp/borders.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "kernels/nricp/match.h"

namespace toile {

namespace {

Vec3 row(const Vertices& X, Eigen::Index i) { return X.row(i).transpose(); }

/// Of a curve's vertices with their neighbours beside, (1 2 1) / 4; x is (n,3).
Vertices smoothed(const Vertices& x, const Border& border) {
    Vertices y = x;
    for (std::size_t i = 0; i < border.vertex.size(); ++i) {
        const auto [a, b] = border.beside[i];
        y.row(border.vertex[i]) = 0.5 * x.row(border.vertex[i]) + 0.25 * (x.row(a) + x.row(b));
    }
    return y;
}

constexpr std::size_t fewest = 8;  // vertices: fewer are a fin's or a scrap's
constexpr double shortest = 0.5;   // a hole, or a scrap's edge, is shorter than this share of the template's curve

}  // namespace

TemplateBorders::TemplateBorders(const Vertices& V, const Vertices& N, const Faces& F, const Vector& seen) {
    for (Border& b : borders(V, N, F)) {
        const auto hidden = [&](int v) { return seen[v] <= 0; };
        if (b.vertex.size() < fewest || std::all_of(b.vertex.begin(), b.vertex.end(), hidden)) continue;
        for (int v : b.vertex)
            if (!hidden(v)) vertices.push_back(v);
        curves.push_back(std::move(b));
    }
    std::sort(vertices.begin(), vertices.end());
}

BorderTarget::BorderTarget(const TemplateBorders& of_template, const NricpTarget& target)
    : borders_(of_template), target_(target) {
    double least = INFINITY;
    for (const Border& own : of_template.curves) least = std::min(least, shortest * own.total());
    if (of_template.curves.empty()) return;
    for (Border& border : borders(target.V(), target.N(), target.F())) {
        const double length = border.total();
        if (length < least) continue;
        const Vec3 facing = border.facing().transpose();
        constexpr int passes = 2;
        Vertices place = target.V(), conormal = Vertices::Zero(place.rows(), 3);
        conormal(border.vertex, Eigen::all) = border.conormal;
        for (int k = 0; k < passes; ++k) {
            place = smoothed(place, border);
            conormal = smoothed(conormal, border);
        }
        conormal = conormal(border.vertex, Eigen::all).rowwise().normalized().eval();
        const Vertices given = target.V()(border.vertex, Eigen::all);
        const Vector inwards = (place(border.vertex, Eigen::all) - given).cwiseProduct(conormal).rowwise().sum();
        place = given + inwards.asDiagonal() * conormal;
        OrientedTree tree(place, conormal);
        border.conormal = std::move(conormal);
        curves_.push_back({std::move(border), std::move(place), length, facing, std::move(tree)});
    }
}

void BorderTarget::pull(const Pose& pose, const MatchSettings& settings, const std::vector<char>& bound,
                        Pull& pull) const {
    if (settings.border_weight <= 0) return;
    for (const Border& own : borders_.curves) pull_curve(own, pose, settings, bound, pull);
}

void BorderTarget::pull_curve(const Border& own, const Pose& pose, const MatchSettings& s,
                              const std::vector<char>& bound, Pull& pull) const {
    const std::size_t count = own.vertex.size();
    std::vector<Vec3> along(count), off(count);
    Vec3 facing = Vec3::Zero();
    const double total = own.total();
    for (std::size_t i = 0; i < count; ++i) {
        const auto [a, b] = own.beside[i];
        along[i] = (row(pose.V, b) - row(pose.V, a)).normalized();
        off[i] = along[i].cross(row(pose.N, own.vertex[i])).normalized();
        facing += own.length[i] / total * off[i];
    }
    std::vector<const Curve*> candidates;
    for (const Curve& curve : curves_) {
        constexpr double agreement = 0.3;  // of where the curves face: a hole's conormals cancel
        if (curve.length >= shortest * total && curve.facing.dot(facing) >= agreement * facing.squaredNorm())
            candidates.push_back(&curve);
    }
    for (std::size_t i = 0; i < count; ++i) {
        const int v = own.vertex[i];
        if (bound[v]) continue;
        const Vec3 p = row(pose.V, v);
        double nearest = 9 * s.mu * s.mu, cosine = 0, confidence = 0;
        Vec3 residual = Vec3::Zero();
        for (const Curve* curve : candidates) {
            const int hit = curve->tree.nearest(p, off[i], s.spread, 3 * s.mu);
            if (hit < 0) continue;
            const Vec3 d = row(curve->place, hit) - p;
            const double agree = off[i].dot(row(curve->border.conormal, hit));
            const ScanPoint at = target_.vertex(curve->border.vertex[hit]);
            const bool outwards = row(pose.N, v).dot(at.normal) > 0;
            if (agree <= 0 || !outwards || d.squaredNorm() >= nearest) continue;
            nearest = d.squaredNorm();
            cosine = agree;
            confidence = at.confidence;
            residual = d;
        }
        if (cosine <= 0) continue;
        const double weight = geman_mcclure(nearest, s.mu) * cosine * cosine * confidence;
        constexpr double wide = 0.04, slip = 0.05;  // as a strip of surface, nearly free along the curve
        const Mat3 across = Mat3::Identity() - (1 - slip) * along[i] * along[i].transpose();
        pull.matched[v] = std::max(pull.matched[v], weight);
        pull.add(v, s.border_weight * wide * own.length[i] * weight * across, residual);
    }
}

}  // namespace toile
