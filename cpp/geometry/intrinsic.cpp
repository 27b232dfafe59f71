#include "geometry/intrinsic.h"

#include <algorithm>
#include <cmath>

namespace toile {

namespace {

struct Shape {
    double area;
    Vec3 cotangent;  // per corner
};

/// Heron's formula in Kahan's order, which keeps its accuracy on needles.
Shape shape_of(const Eigen::RowVector3d& lengths) {
    Vec3 s = lengths;
    std::sort(s.data(), s.data() + 3);
    const double c = s[0], b = s[1], a = s[2];
    Shape shape;
    shape.area = 0.25 * std::sqrt(std::max(0.0, (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))));
    for (int k = 0; k < 3; ++k) {
        const double opposite = lengths[k], p = lengths[(k + 1) % 3], q = lengths[(k + 2) % 3];
        shape.cotangent[k] = ((p - opposite) * (p + opposite) + q * q) / (4 * shape.area);
    }
    return shape;
}

}  // namespace

Vertices edge_lengths(const Vertices& V, const Faces& F) {
    Vertices lengths(F.rows(), 3);
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) lengths(f, c) = (V.row(F(f, (c + 1) % 3)) - V.row(F(f, (c + 2) % 3))).norm();
    return lengths;
}

double mollify(Vertices& lengths, double margin) {
    double added = 0;
    for (Eigen::Index f = 0; f < lengths.rows(); ++f)
        for (int c = 0; c < 3; ++c)
            added = std::max(added, margin + lengths(f, c) - lengths(f, (c + 1) % 3) - lengths(f, (c + 2) % 3));
    lengths.array() += added;
    return added;
}

Sparse intrinsic_laplacian(const Vertices& lengths, const Faces& F, Eigen::Index n) {
    std::vector<Eigen::Triplet<double>> entries;
    entries.reserve(static_cast<std::size_t>(F.rows()) * 12);
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const Shape shape = shape_of(lengths.row(f));
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, (c + 1) % 3), j = F(f, (c + 2) % 3);
            const double w = 0.5 * shape.cotangent[c];
            entries.emplace_back(i, j, w);
            entries.emplace_back(j, i, w);
            entries.emplace_back(i, i, -w);
            entries.emplace_back(j, j, -w);
        }
    }
    Sparse L(n, n);
    L.setFromTriplets(entries.begin(), entries.end());
    return L;
}

Vector intrinsic_voronoi_mass(const Vertices& lengths, const Faces& F, Eigen::Index n) {
    Vector mass = Vector::Zero(n);
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const Shape shape = shape_of(lengths.row(f));
        Eigen::Index sharpest;
        const bool obtuse = shape.cotangent.minCoeff(&sharpest) < 0;  // at the corner of the least cotangent
        for (int c = 0; c < 3; ++c) {
            const int next = (c + 1) % 3, last = (c + 2) % 3;
            const double share = obtuse ? shape.area / (c == sharpest ? 2 : 4)
                                        : (lengths(f, next) * lengths(f, next) * shape.cotangent[next] +
                                           lengths(f, last) * lengths(f, last) * shape.cotangent[last]) /
                                              8;
            mass[F(f, c)] += share;
        }
    }
    return mass;
}

}  // namespace toile
