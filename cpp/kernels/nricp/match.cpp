#include "kernels/nricp/match.h"

#include <algorithm>
#include <cmath>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

namespace {

/// Point-to-plane with a share of point-to-point.
Mat3 plane_weight(const Vec3& n, double point_weight) {
    return (1 - point_weight) * n * n.transpose() + point_weight * Mat3::Identity();
}

/// The plane of a match: between both normals, as in the symmetric objective (Rusinkiewicz 2019), nearer the
/// template's, which carries no noise.
Vec3 between(const Vec3& scan, const Vec3& model) {
    constexpr double share = 0.7;
    return ((1 - share) * scan + share * model).normalized();
}

Vec3 row(const Vertices& X, Eigen::Index i) { return X.row(i).transpose(); }

/// Loop vertices to the closest point of their closed polyline, free along it.
void pull_to_loops(const NricpFrame& frame, const Vertices& x, double boundary_weight, Pull& pull) {
    const double n = x.rows();
    for (const NricpLoop& loop : frame.loops)
        for (Eigen::Index i = 0; i < loop.vertices.size(); ++i) {
            const int v = loop.vertices[i];
            const Vec3 p = x.row(v).transpose();
            Vec3 best = Vec3::Zero(), tangent = Vec3::Zero();
            double squared = INFINITY;
            for (Eigen::Index k = 0, m = loop.polyline.rows(); k < m; ++k) {
                const Vec3 a = loop.polyline.row(k).transpose(), e = loop.polyline.row((k + 1) % m).transpose() - a;
                const double length2 = e.squaredNorm();
                const Vec3 q = a + (length2 > 0 ? std::clamp(e.dot(p - a) / length2, 0.0, 1.0) : 0.0) * e;
                if (const double d = (q - p).squaredNorm(); d < squared) {
                    squared = d;
                    best = q;
                    tangent = length2 > 0 ? Vec3(e / std::sqrt(length2)) : Vec3::Zero();
                }
            }
            constexpr double along = 0.05;  // a little point-to-point, so that ends do not slide
            const Mat3 across = Mat3::Identity() - (1 - along) * tangent * tangent.transpose();
            pull.add(v, boundary_weight / n * across, best - p);
        }
}

void pull_to_landmarks(const NricpFrame& frame, const Vertices& x, Pull& pull) {
    const NricpLandmarks& marks = frame.landmarks;
    const Eigen::Index k = marks.W.rows();
    for (Eigen::Index i = 0; i < k; ++i) {
        const double sigma = marks.sigma[marks.sigma.size() == 1 ? 0 : i];
        constexpr double typical = 0.0015;  // surface noise against which sigma counts, per unit of the template's size
        const double w = typical * typical / (sigma * sigma) / std::max<Eigen::Index>(k, 1);
        Vec3 residual = marks.P.row(i).transpose();
        using Row = Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator;
        for (Row r(marks.W, i); r; ++r) residual -= r.value() * x.row(r.col()).transpose();
        for (Row r(marks.W, i); r; ++r) pull.add(r.col(), w * r.value() * Mat3::Identity(), residual);
    }
}

}  // namespace

Matcher::Matcher(const NricpFrame& frame, const NricpTarget& target, const TemplateBorders& of_template, Eigen::Index n)
    : frame_(frame), target_(target), borders_(of_template, target), in_loop_(static_cast<std::size_t>(n), 0),
      guess_(static_cast<std::size_t>(n), -1), marked_(of_template.vertices) {
    for (const NricpLoop& loop : frame.loops) {
        marked_.insert(marked_.end(), loop.vertices.begin(), loop.vertices.end());
        for (int v : loop.vertices) in_loop_[v] = 1;
    }
    using Row = Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator;
    for (Eigen::Index i = 0; i < frame.landmarks.W.rows(); ++i)
        for (Row r(frame.landmarks.W, i); r; ++r) marked_.push_back(static_cast<int>(r.col()));
    std::sort(marked_.begin(), marked_.end());
    marked_.erase(std::unique(marked_.begin(), marked_.end()), marked_.end());
}

void Matcher::to_scan(const Pose& pose, const Samples& samples, const MatchSettings& s, Pull& pull) {
    const auto count = static_cast<std::int64_t>(samples.vertex.size());
    std::vector<double> squared(samples.vertex.size(), 0);
    parallel_for(count, [&](std::int64_t i) {
        const int v = samples.vertex[i];
        const Vec3 p = row(pose.V, v), m = row(pose.N, v);
        const int last = guess_[v], near = s.local && last >= 0 ? target_.descend(p, m, s.spread, last)
                                                                : target_.nearest(p, m, s.spread, INFINITY, last);
        guess_[v] = near;
        if (near < 0) return;
        const ScanPoint hit = s.surface ? target_.closest(near, p, s.phong) : target_.vertex(near);
        const double cosine = hit.normal.dot(m), distance2 = (hit.point - p).squaredNorm();
        if (hit.open || cosine <= 0 || distance2 > 9 * s.mu * s.mu) return;
        pull.matched[v] = geman_mcclure(distance2, s.mu) * cosine * cosine * hit.confidence;
        const Vec3 plane = between(hit.normal, m);
        squared[i] = std::pow(plane.dot(hit.point - p), 2);
        pull.add(v, samples.area[i] * pull.matched[v] * plane_weight(plane, s.point_weight), hit.point - p);
    });
    double weight = 0, seen = 0;
    for (std::size_t i = 0; i < samples.vertex.size(); ++i) {
        const double w = samples.area[i] * pull.matched[samples.vertex[i]];
        pull.energy += w * squared[i];
        weight += w;
        seen += samples.area[i];
    }
    pull.rms = weight > 0 ? std::sqrt(pull.energy / weight) : 0;
    pull.overlap = seen > 0 ? weight / seen : 0;
}

/// Scan vertices, up to `most` and about twice as many as samples, each to the closest sample as it stands.
void Matcher::from_scan(const Pose& pose, Samples& samples, const MatchSettings& s, Pull& pull) {
    constexpr Eigen::Index most = 4000;
    const auto wanted = std::min<Eigen::Index>(most, 2 * static_cast<Eigen::Index>(samples.vertex.size()));
    const Eigen::Index step = std::max<Eigen::Index>(1, target_.size() / std::max<Eigen::Index>(wanted, 1));
    const Eigen::Index count = target_.size() / step;
    std::vector<int> near(static_cast<std::size_t>(count), -1);
    samples.follow(pose);
    if (reverse_samples_ != &samples) reverse_guess_.assign(static_cast<std::size_t>(count), -1);
    reverse_samples_ = &samples;
    parallel_for(count, [&](std::int64_t i) {
        const ScanPoint from = target_.vertex(static_cast<int>(i * step));
        near[i] = samples.tree.nearest(from.point, from.normal, s.spread, INFINITY, reverse_guess_[i]);
        reverse_guess_[i] = near[i];
    });
    for (Eigen::Index i = 0; i < count; ++i) {
        if (near[i] < 0) continue;
        const int v = samples.vertex[near[i]];
        const ScanPoint from = target_.vertex(static_cast<int>(i * step));
        const Vec3 residual = from.point - row(pose.V, v);
        const double cosine = from.normal.dot(row(pose.N, v));
        if (cosine <= 0 || residual.squaredNorm() > 9 * s.mu * s.mu) continue;
        const double robust = geman_mcclure(residual.squaredNorm(), s.mu);
        const double w = s.reverse / count * robust * cosine * cosine * from.confidence;
        const Vec3 plane = between(from.normal, row(pose.N, v));
        pull.add(v, w * plane_weight(plane, s.point_weight), residual);
    }
}

Pull Matcher::pull(const Pose& pose, Samples& samples, const MatchSettings& settings) {
    const Eigen::Index n = pose.V.rows();
    std::vector<Mat3> A(static_cast<std::size_t>(n), Mat3::Zero());
    Pull pull{std::move(A), Vertices::Zero(n, 3), Vector::Zero(n), marked_};
    to_scan(pose, samples, settings, pull);
    if (settings.reverse > 0) from_scan(pose, samples, settings, pull);
    borders_.pull(pose, settings, in_loop_, pull);
    pull_to_loops(frame_, pose.V, settings.boundary_weight, pull);
    pull_to_landmarks(frame_, pose.V, pull);
    return pull;
}

}  // namespace toile
