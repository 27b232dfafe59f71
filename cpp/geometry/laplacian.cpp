#include "geometry/laplacian.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>

namespace toile {

namespace {

Vec3 double_area_vector(const Vertices& V, const Faces& F, Eigen::Index f) {
    const Vec3 a = V.row(F(f, 0)), b = V.row(F(f, 1)), c = V.row(F(f, 2));
    return (b - a).cross(c - a);
}

/// Cotangents of the corner angles; zero for a face of no area, which then adds nothing. A needle of 1e-100 counts as
/// such a face: beyond, cotangents and sums of them leave the range of doubles.
std::array<double, 3> corner_cotangents(const Vertices& V, const Faces& F, Eigen::Index f) {
    std::array<double, 3> cot{};
    const double twice_area = double_area_vector(V, F, f).norm();
    double longest = 0;
    for (int c = 0; c < 3; ++c) longest = std::max(longest, (V.row(F(f, c)) - V.row(F(f, (c + 1) % 3))).squaredNorm());
    if (twice_area <= 1e-100 * longest) return cot;
    for (int c = 0; c < 3; ++c) {
        const Vec3 p = V.row(F(f, c)), q = V.row(F(f, (c + 1) % 3)), r = V.row(F(f, (c + 2) % 3));
        cot[static_cast<std::size_t>(c)] = (q - p).dot(r - p) / twice_area;
    }
    return cot;
}

}  // namespace

Sparse cotangent_laplacian(const Vertices& V, const Faces& F) {
    std::vector<Eigen::Triplet<double>> entries;
    entries.reserve(static_cast<std::size_t>(F.rows()) * 12);
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const auto cot = corner_cotangents(V, F, f);
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, (c + 1) % 3), j = F(f, (c + 2) % 3);
            const double w = 0.5 * cot[static_cast<std::size_t>(c)];
            entries.emplace_back(i, j, w);
            entries.emplace_back(j, i, w);
            entries.emplace_back(i, i, -w);
            entries.emplace_back(j, j, -w);
        }
    }
    Sparse L(V.rows(), V.rows());
    L.setFromTriplets(entries.begin(), entries.end());
    return L;
}

Vector voronoi_mass(const Vertices& V, const Faces& F) {
    Vector mass = Vector::Zero(V.rows());
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const double area = 0.5 * double_area_vector(V, F, f).norm();
        const auto cot = corner_cotangents(V, F, f);
        int obtuse = -1;
        for (int c = 0; c < 3; ++c)
            if (cot[static_cast<std::size_t>(c)] < 0) obtuse = c;
        for (int c = 0; c < 3; ++c) {
            const int next = (c + 1) % 3, last = (c + 2) % 3;
            double share = obtuse == c ? area / 2 : area / 4;
            if (obtuse < 0)
                share = ((V.row(F(f, next)) - V.row(F(f, c))).squaredNorm() * cot[static_cast<std::size_t>(last)] +
                         (V.row(F(f, last)) - V.row(F(f, c))).squaredNorm() * cot[static_cast<std::size_t>(next)]) /
                        8;
            mass[F(f, c)] += share;
        }
    }
    return mass;
}

Vertices face_normals(const Vertices& V, const Faces& F) {
    Vertices N(F.rows(), 3);
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const Vec3 n = double_area_vector(V, F, f);
        const double length = n.norm();
        N.row(f) = length > 0 ? (n / length).transpose().eval() : Eigen::RowVector3d::Zero().eval();
    }
    return N;
}

Vector face_areas(const Vertices& V, const Faces& F) {
    Vector A(F.rows());
    for (Eigen::Index f = 0; f < F.rows(); ++f) A[f] = 0.5 * double_area_vector(V, F, f).norm();
    return A;
}

Vertices vertex_normals(const Vertices& V, const Faces& F) {
    constexpr double cancelled = 1e-12;  // a share of the faces' area that rounding leaves where they face each other
    Vertices N = Vertices::Zero(V.rows(), 3);
    Vector area = Vector::Zero(V.rows());
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const Vec3 n = double_area_vector(V, F, f);
        for (int c = 0; c < 3; ++c) {
            N.row(F(f, c)) += n.transpose();
            area[F(f, c)] += n.norm();
        }
    }
    for (Eigen::Index v = 0; v < V.rows(); ++v) {
        const double length = N.row(v).norm();
        if (length > cancelled * area[v])
            N.row(v) /= length;
        else
            N.row(v).setZero();
    }
    return N;
}

}  // namespace toile
