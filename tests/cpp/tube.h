// A small skinned body for tests of kernels that take one.
#pragma once
#include <cmath>

#include "geometry/body_model.h"

/// A tube of three bones along z with two shape directions, and keypoints on joints and rings.
inline toile::BodyModel tube() {
    const int rings = 13, sides = 12;
    using namespace toile;
    BodyModel m;
    m.v_template.resize(rings * sides, 3);
    m.weights_idx = Eigen::MatrixXi::Zero(rings * sides, 3);
    m.weights_val = Matrix::Zero(rings * sides, 3);
    m.shapedirs = Matrix::Zero(3 * rings * sides, 2);
    for (int r = 0; r < rings; ++r)
        for (int s = 0; s < sides; ++s) {
            const int v = r * sides + s;
            const double z = 0.1 * r, a = 2 * M_PI * s / sides, x = 0.1 * std::cos(a), y = 0.07 * std::sin(a);
            m.v_template.row(v) << x, y, z;
            m.shapedirs.row(3 * v) << 0.1 * x, 0;
            m.shapedirs.row(3 * v + 1) << 0.1 * y, 0;
            m.shapedirs.row(3 * v + 2) << 0, 0.05 * z;
            for (int b = 0; b < 3; ++b) {
                m.weights_idx(v, b) = b;
                m.weights_val(v, b) = std::exp(-50 * (z - 0.2 - 0.4 * b) * (z - 0.2 - 0.4 * b));
            }
            m.weights_val.row(v) /= m.weights_val.row(v).sum();
        }
    m.F.resize(2 * (rings - 1) * sides, 3);
    for (int r = 0, f = 0; r + 1 < rings; ++r)
        for (int s = 0; s < sides; ++s) {
            const int a = r * sides + s, b = r * sides + (s + 1) % sides;
            m.F.row(f++) << a, b, b + sides;
            m.F.row(f++) << a, b + sides, a + sides;
        }
    m.parents = {-1, 0, 1};
    m.J.resize(3, 3);
    m.J << 0, 0, 0, 0, 0, 0.4, 0, 0, 0.8;
    m.J_shapedirs = Matrix::Zero(9, 2);
    m.J_shapedirs(5, 1) = 0.02;
    m.J_shapedirs(8, 1) = 0.04;
    for (int k = 0; k < 3; ++k) m.keypoints.push_back({"joint", k, {}, {}});
    for (int r = 0; r < rings; r += 3) m.keypoints.push_back({"spot", -1, {r * sides, r * sides + 3}, {0.5, 0.5}});
    return m;
}
