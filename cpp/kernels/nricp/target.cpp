#include "kernels/nricp/target.h"

#include <algorithm>
#include <cmath>

#include "geometry/closest.h"
#include "geometry/confidence.h"
#include "geometry/laplacian.h"
#include "geometry/weld.h"

namespace toile {

namespace {

Vec3 row(const Vertices& X, Eigen::Index i) { return X.row(i).transpose(); }

/// Faces without the small closed components (floating clutter).
Faces without_clutter(const Vertices& V, const Faces& F) {
    const Indices component = vertex_components(F, V.rows());
    const std::vector<char> boundary = open_vertices(F, V.rows());
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

}  // namespace

Faces target_faces(const NricpFrame& frame, const std::vector<int>& valid) {
    const Indices& labels = frame.labels;
    if (labels.size() == 0) return without_clutter(frame.V, trusted_faces(frame.F, frame.confidence));
    std::vector<int> keep;
    for (int f = 0; f < frame.F.rows(); ++f)
        if (std::find(valid.begin(), valid.end(), labels[f]) != valid.end()) keep.push_back(f);
    return trusted_faces(frame.F(keep, Eigen::all), frame.confidence);
}

Samples::Samples(const Vertices& V, const Vertices& N, std::vector<int> v, std::vector<double> a, std::vector<int> s)
    : vertex(std::move(v)), area(std::move(a)), stands(std::move(s)),
      tree(V(vertex, Eigen::all), N(vertex, Eigen::all)) {}

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

/// Noise of the vertices along their normals, from the median angle between normals at the ends of a side, and the mean
/// side. Normals of a mesh with deviation s and sides e differ by about 1.4 s / e; the body's own curvature by less
/// than the angle that is taken off.
std::pair<double, double> noise_of(const Vertices& V, const Vertices& N, const Faces& F) {
    constexpr Eigen::Index enough = 20000;  // faces
    const Eigen::Index step = 1 + F.rows() / enough;
    std::vector<double> bend;
    double edge = 0;
    for (Eigen::Index f = 0; f < F.rows(); f += step)
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, c), j = F(f, (c + 1) % 3);
            bend.push_back(1 - N.row(i).dot(N.row(j)));
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

NricpTarget::NricpTarget(const Vertices& V, const Faces& F, const Vector& confidence) {
    const Faces whole = weld(V, F).F;
    const Vertices N = vertex_normals(V, whole);
    const auto [used, faces] = used_part(N, whole);
    V_ = V(used, Eigen::all);
    N_ = N(used, Eigen::all);
    F_ = faces;
    confidence_ = confidence.size() ? Vector(confidence(used)) : Vector::Ones(V_.rows());
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

int NricpTarget::descend(const Vec3& x, const Vec3& n, double spread, int from) const {
    const double half = spread * spread / 2;
    const auto measure = [&](int v) { return (row(V_, v) - x).squaredNorm() + half * (row(N_, v) - n).squaredNorm(); };
    int at = from;
    for (double least = measure(from);;) {
        const int here = at;
        for (int i = faces_.start[here]; i < faces_.start[here + 1]; ++i)
            for (int c = 0; c < 3; ++c)
                if (const int v = F_(faces_.index[i], c); v != here)
                    if (const double m = measure(v); m < least) {
                        least = m;
                        at = v;
                    }
        if (at == here) return at;
    }
}

ScanPoint NricpTarget::vertex(int v) const {
    return {row(V_, v), row(N_, v), static_cast<bool>(open_[v]), confidence_[v]};
}

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
        if (best.barycentric[c] < touch)
            interior = false;
        else
            corners_open &= static_cast<bool>(open_[i]);
    }
    const double length = normal.norm();
    return {best.point + phong * lift, length > 0 ? Vec3(normal / length) : row(N_, v), !interior && corners_open,
            confidence_at(confidence_, F_.row(best.face), best.barycentric)};
}

}  // namespace toile
