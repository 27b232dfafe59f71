#include "kernels/nricp_match.h"

#include <algorithm>
#include <cmath>

#include "base/errors.h"
#include "base/parallel.h"
#include "geometry/closest.h"
#include "geometry/laplacian.h"
#include "geometry/topology.h"

namespace toile {

namespace {

/// Faces without the small closed components (floating clutter).
Faces without_clutter(const Vertices& V, const Faces& F) {
    const Indices component = vertex_components(F, V.rows());
    const std::vector<char> boundary = boundary_vertices(F, V.rows());
    const Vector areas = face_areas(V, F);
    Vector area = Vector::Zero(component.maxCoeff() + 1);
    std::vector<char> open(static_cast<std::size_t>(area.size()), 0);
    for (Eigen::Index f = 0; f < F.rows(); ++f) area[component[F(f, 0)]] += areas[f];
    for (Eigen::Index v = 0; v < V.rows(); ++v) open[component[v]] |= boundary[v];
    constexpr double small = 0.05;  // of the scan's area
    const double least = small * area.sum();
    std::vector<int> keep;
    for (int f = 0; f < F.rows(); ++f)
        if (const int c = component[F(f, 0)]; open[c] || area[c] >= least) keep.push_back(f);
    return F(keep, Eigen::all);
}

double geman_mcclure(double squared, double mu) {
    const double w = mu * mu / (mu * mu + squared);
    return w * w;
}

/// Point-to-plane with a share of point-to-point.
Mat3 plane_weight(const Vec3& n, double point_weight) {
    return (1 - point_weight) * n * n.transpose() + point_weight * Mat3::Identity();
}

/// The plane of a match: between both normals, as in the symmetric objective (Rusinkiewicz 2019), nearer the template's,
/// which carries no noise.
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

Faces target_faces(const Vertices& V, const Faces& F, const Indices& labels, const std::vector<int>& valid) {
    if (labels.size() == 0) return without_clutter(V, F);
    std::vector<int> keep;
    for (int f = 0; f < F.rows(); ++f)
        if (std::find(valid.begin(), valid.end(), labels[f]) != valid.end()) keep.push_back(f);
    return F(keep, Eigen::all);
}

Samples::Samples(const Vertices& V, const Vertices& N, std::vector<int> v, std::vector<double> a)
    : vertex(std::move(v)), area(std::move(a)), tree(V(vertex, Eigen::all), N(vertex, Eigen::all)) {}

void Samples::follow(const Pose& pose) { tree.follow(pose.V(vertex, Eigen::all), pose.N(vertex, Eigen::all)); }

namespace {

/// The vertices of F and F in their numbers; a vertex without a normal is left out with its faces.
std::pair<std::vector<int>, Faces> used_part(const Vertices& N, const Faces& F) {
    std::vector<int> number(static_cast<std::size_t>(N.rows()), -1), used, keep;
    for (int f = 0; f < F.rows(); ++f) {
        const bool sound = N.row(F(f, 0)).any() && N.row(F(f, 1)).any() && N.row(F(f, 2)).any();
        if (sound) keep.push_back(f);
        if (sound)
            for (int c = 0; c < 3; ++c) number[F(f, c)] = 0;
    }
    for (int v = 0; v < N.rows(); ++v)
        if (number[v] == 0) {
            number[v] = static_cast<int>(used.size());
            used.push_back(v);
        }
    return {used, F(keep, Eigen::all).unaryExpr([&](int v) { return number[v]; })};
}

/// Vertices on the border, or where faces meet in odd numbers: in a closed ring every neighbour is seen twice, so that
/// the neighbours' hashes cancel (splitmix64). A tenth of the time of counting edges.
std::vector<char> open_vertices(const Faces& F, Eigen::Index n) {
    const auto hash = [](int v) {
        std::uint64_t z = (static_cast<std::uint64_t>(v) + 1) * 0x9e3779b97f4a7c15ull;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
        return z ^ (z >> 31);
    };
    std::vector<std::uint64_t> sum(static_cast<std::size_t>(n), 0);
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) sum[F(f, c)] ^= hash(F(f, (c + 1) % 3)) ^ hash(F(f, (c + 2) % 3));
    std::vector<char> open(sum.size());
    std::transform(sum.begin(), sum.end(), open.begin(), [](std::uint64_t x) { return x != 0; });
    return open;
}

/// Noise of the vertices along their normals, from the median angle between normals at the ends of a side, and the mean
/// side. Normals of a mesh with deviation s and sides e differ by about 1.4 s / e; the body's own curvature by less
/// than the angle that is taken off.
std::pair<double, double> noise_of(const Vertices& V, const Vertices& N, const Faces& F) {
    std::vector<double> bend(static_cast<std::size_t>(3 * F.rows()));
    double edge = 0;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, c), j = F(f, (c + 1) % 3);
            bend[3 * f + c] = 1 - N.row(i).dot(N.row(j));
            edge += (V.row(i) - V.row(j)).norm();
        }
    if (bend.empty()) return {0, 1};
    edge = std::max(edge / bend.size(), 1e-12);
    const auto middle = bend.begin() + bend.size() / 2;
    std::nth_element(bend.begin(), middle, bend.end());
    constexpr double curvature = 0.004, per_ratio = 1.4;
    return {edge * std::sqrt(2 * std::max(0.0, *middle - curvature)) / per_ratio, edge};
}

/// Each normal with those of the faces about it.
Vertices smoothed(const Vertices& N, const Faces& F) {
    Vertices S = 2 * N;
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const Eigen::RowVector3d sum = N.row(F(f, 0)) + N.row(F(f, 1)) + N.row(F(f, 2));
        for (int c = 0; c < 3; ++c) S.row(F(f, c)) += sum;
    }
    for (Eigen::Index v = 0; v < S.rows(); ++v)
        if (const double length = S.row(v).norm(); length > 0) S.row(v) /= length;
    return S;
}

}  // namespace

NricpTarget::NricpTarget(const Vertices& V, const Faces& F) {
    const Vertices N = vertex_normals(V, F);
    const auto [used, faces] = used_part(N, F);
    V_ = V(used, Eigen::all);
    N_ = N(used, Eigen::all);
    F_ = faces;
    faces_ = vertex_faces(F_, V_.rows());
    open_ = open_vertices(F_, V_.rows());
    const auto [noise, edge] = noise_of(V_, N_, F_);
    noise_ = noise;
    constexpr double passes = 8, most = 3;
    for (int k = 0; k < std::min(most, std::round(passes * noise / edge)); ++k) N_ = smoothed(N_, F_);
    tree_ = OrientedTree(V_, N_);
}

void NricpTarget::orient(const Samples& samples, const Pose& start) {
    constexpr std::size_t enough = 500;
    const std::size_t step = std::max<std::size_t>(1, samples.vertex.size() / enough);
    double agreement = 0;
    for (std::size_t i = 0; i < samples.vertex.size(); i += step) {
        const int v = samples.vertex[i], hit = tree_.nearest(row(start.V, v), row(start.N, v), 0, INFINITY);
        if (hit >= 0) agreement += samples.area[i] * N_.row(hit).dot(start.N.row(v));
    }
    if (agreement >= 0) return;
    N_ = -N_;
    tree_.follow(V_, N_);
}

ScanPoint NricpTarget::vertex(int v) const { return {row(V_, v), row(N_, v), static_cast<bool>(open_[v])}; }

ScanPoint NricpTarget::closest(int v, const Vec3& x, double phong) const {
    SurfacePoint best;
    best.distance = INFINITY;
    for (int i = faces_.start[v]; i < faces_.start[v + 1]; ++i) {
        const int f = faces_.index[i];
        SurfacePoint hit = closest_on_triangle(x, row(V_, F_(f, 0)), row(V_, F_(f, 1)), row(V_, F_(f, 2)));
        if (hit.distance >= best.distance) continue;
        best = hit;
        best.face = f;
    }
    if (best.face < 0) return vertex(v);
    constexpr double touch = 1e-6;
    Vec3 lift = Vec3::Zero(), normal = Vec3::Zero();
    bool interior = true, corners_open = true;  // on the border: a vertex of it, or an edge between two of them
    for (int c = 0; c < 3; ++c) {
        const int i = F_(best.face, c);
        const Vec3 n = row(N_, i);
        normal += best.barycentric[c] * n;
        lift += best.barycentric[c] * n.dot(row(V_, i) - best.point) * n;
        if (best.barycentric[c] < touch) interior = false;
        else corners_open &= static_cast<bool>(open_[i]);
    }
    const double length = normal.norm();
    return {best.point + phong * lift, length > 0 ? Vec3(normal / length) : row(N_, v), !interior && corners_open};
}

Matcher::Matcher(const NricpFrame& frame, const NricpTarget& target, Eigen::Index n)
    : frame_(frame), target_(target), guess_(static_cast<std::size_t>(n), -1),
      reverse_guess_(static_cast<std::size_t>(target.size()), -1) {
    for (const NricpLoop& loop : frame.loops) marked_.insert(marked_.end(), loop.vertices.begin(), loop.vertices.end());
    const auto& W = frame.landmarks.W;
    for (Eigen::Index i = 0; i < W.rows(); ++i)
        for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator r(W, i); r; ++r) marked_.push_back(static_cast<int>(r.col()));
    std::sort(marked_.begin(), marked_.end());
    marked_.erase(std::unique(marked_.begin(), marked_.end()), marked_.end());
}

void Matcher::to_scan(const Pose& pose, const Samples& samples, const MatchSettings& s, Pull& pull) {
    const auto count = static_cast<std::int64_t>(samples.vertex.size());
    std::vector<double> squared(samples.vertex.size(), 0);
    parallel_for(count, [&](std::int64_t i) {
        const int v = samples.vertex[i];
        const Vec3 p = row(pose.V, v), m = row(pose.N, v);
        const int near = target_.nearest(p, m, s.spread, INFINITY, guess_[v]);
        guess_[v] = near;
        if (near < 0) return;
        const ScanPoint hit = s.surface ? target_.closest(near, p, s.phong) : target_.vertex(near);
        const double cosine = hit.normal.dot(m), distance2 = (hit.point - p).squaredNorm();
        if (hit.open || cosine <= 0 || distance2 > 9 * s.mu * s.mu) return;
        pull.matched[v] = geman_mcclure(distance2, s.mu) * cosine * cosine;
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
    const Eigen::Index step = std::max<Eigen::Index>(1, target_.size() / std::max<Eigen::Index>(wanted, 1)), count = target_.size() / step;
    std::vector<int> near(static_cast<std::size_t>(count), -1);
    samples.follow(pose);
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
        const double w = s.reverse / count * geman_mcclure(residual.squaredNorm(), s.mu) * cosine * cosine;
        const Vec3 plane = between(from.normal, row(pose.N, v));
        pull.add(v, w * plane_weight(plane, s.point_weight), residual);
    }
}

Pull Matcher::pull(const Pose& pose, Samples& samples, const MatchSettings& settings) {
    const Eigen::Index n = pose.V.rows();
    Pull pull{std::vector<Mat3>(static_cast<std::size_t>(n), Mat3::Zero()), Vertices::Zero(n, 3), Vector::Zero(n), marked_};
    to_scan(pose, samples, settings, pull);
    if (settings.reverse > 0) from_scan(pose, samples, settings, pull);
    pull_to_loops(frame_, pose.V, settings.boundary_weight, pull);
    pull_to_landmarks(frame_, pose.V, pull);
    return pull;
}

}  // namespace toile
