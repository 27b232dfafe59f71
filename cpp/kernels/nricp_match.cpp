#include "kernels/nricp_match.h"

#include <algorithm>
#include <cmath>

#include "base/errors.h"
#include "base/parallel.h"
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

void pull_to_scan(const NricpTarget& target, const Vertices& x, const Vertices& normals, const Vector& area,
                  const Vector& visible, const MatchSettings& s, Pull& pull) {
    std::vector<double> squared(static_cast<std::size_t>(x.rows()), 0);
    parallel_for(x.rows(), [&](std::int64_t v) {
        if (visible[v] == 0) return;
        const Vec3 p = x.row(v).transpose();
        const SurfacePoint hit = target.index.closest(p, 3 * s.mu);
        if (hit.face < 0 || target.on_boundary(hit)) return;
        const Vec3 n = target.normal_at(hit);
        const double cosine = n.dot(normals.row(v));
        if (cosine <= 0) return;
        pull.matched[v] = geman_mcclure(hit.distance * hit.distance, s.mu) * cosine * cosine;
        const Vec3 residual = hit.point - p;
        squared[v] = std::pow(n.dot(residual), 2);
        pull.add(v, area[v] * pull.matched[v] * plane_weight(n, s.point_weight), residual);
    });
    double weight = 0, seen = 0;
    for (Eigen::Index v = 0; v < x.rows(); ++v) {
        const double w = area[v] * pull.matched[v];
        pull.energy += w * squared[v];
        weight += w;
        seen += area[v] * visible[v];
    }
    pull.rms = weight > 0 ? std::sqrt(pull.energy / weight) : 0;
    pull.overlap = seen > 0 ? weight / seen : 0;
}

/// About as many scan vertices as `most`, each to the closest point of the template as it stands.
void pull_from_scan(const NricpTarget& target, const Vertices& x, const Faces& F, const Vertices& normals,
                    const Vector& visible, const MatchSettings& s, Pull& pull) {
    constexpr Eigen::Index most = 4000;
    const Vertices& scan = target.index.vertices();
    const Eigen::Index step = std::max<Eigen::Index>(1, scan.rows() / most), count = scan.rows() / step;
    const SurfaceIndex index(x, F);
    std::vector<SurfacePoint> hits(static_cast<std::size_t>(count));
    parallel_for(count, [&](std::int64_t i) {
        if (target.normals.row(i * step).squaredNorm() > 0)
            hits[i] = index.closest(scan.row(i * step).transpose(), 3 * s.mu);
    });
    for (Eigen::Index i = 0; i < count; ++i) {
        const SurfacePoint& hit = hits[i];
        if (hit.face < 0) continue;
        const Vec3 n = target.sign * target.normals.row(i * step).transpose();
        Vec3 m = Vec3::Zero();
        for (int c = 0; c < 3; ++c) m += hit.barycentric[c] * normals.row(F(hit.face, c)).transpose();
        const double cosine = n.dot(m.normalized());
        if (!(cosine > 0)) continue;
        const double w = s.reverse / count * geman_mcclure(hit.distance * hit.distance, s.mu) * cosine * cosine;
        const Vec3 residual = scan.row(i * step).transpose() - hit.point;
        for (int c = 0; c < 3; ++c)
            if (const int v = F(hit.face, c); visible[v] > 0)
                pull.add(v, w * hit.barycentric[c] * plane_weight(n, s.point_weight), residual);
    }
}

/// Loop vertices to the closest point of their closed polyline, free along it.
void pull_to_loops(const NricpFrame& frame, const Vertices& x, const Vector& area, const MatchSettings& s, Pull& pull) {
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
            pull.add(v, s.boundary_weight * area[v] * across, best - p);
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

NricpTarget::NricpTarget(const Vertices& V, const Faces& F)
    : index(V, F), normals(vertex_normals(V, F)), boundary(boundary_vertices(F, V.rows())) {
    const Edges edges = unique_edges(F);
    for (Eigen::Index e = 0; e < edges.rows(); ++e)
        roughness += 1 - normals.row(edges(e, 0)).dot(normals.row(edges(e, 1)));
    roughness /= std::max<Eigen::Index>(edges.rows(), 1);
}

Vec3 NricpTarget::normal_at(const SurfacePoint& hit) const {
    Vec3 n = Vec3::Zero();
    for (int c = 0; c < 3; ++c) n += hit.barycentric[c] * normals.row(index.faces()(hit.face, c)).transpose();
    const double length = n.norm();
    return length > 0 ? Vec3(sign / length * n) : Vec3::Zero();
}

/// A hit on a boundary vertex or on an edge between two of them.
bool NricpTarget::on_boundary(const SurfacePoint& hit) const {
    constexpr double touch = 1e-6;
    bool corners_on_boundary = true, interior = true;
    for (int c = 0; c < 3; ++c) {
        if (hit.barycentric[c] < touch) interior = false;
        else corners_on_boundary &= static_cast<bool>(boundary[index.faces()(hit.face, c)]);
    }
    return !interior && corners_on_boundary;
}

void NricpTarget::orient(const Vertices& x, const Vertices& template_normals, const Vector& visible) {
    const std::vector<SurfacePoint> hits = index.closest_each(x);
    double agreement = 0;
    for (Eigen::Index v = 0; v < x.rows(); ++v)
        if (hits[v].face >= 0 && visible[v] > 0) agreement += normal_at(hits[v]).dot(template_normals.row(v));
    if (agreement < 0) sign = -sign;
}

Pull pull_of(const NricpTarget& target, const NricpFrame& frame, const Vertices& x, const Faces& F,
             const Vector& area, const Vector& visible, const MatchSettings& settings) {
    const auto n = static_cast<std::size_t>(x.rows());
    Pull pull{std::vector<Mat3>(n, Mat3::Zero()), Vertices::Zero(x.rows(), 3), Vector::Zero(x.rows())};
    const Vertices normals = vertex_normals(x, F);
    pull_to_scan(target, x, normals, area, visible, settings, pull);
    if (settings.reverse > 0) pull_from_scan(target, x, F, normals, visible, settings, pull);
    pull_to_loops(frame, x, area, settings, pull);
    pull_to_landmarks(frame, x, pull);
    return pull;
}

}  // namespace toile
