#include "kernels/paint.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

namespace {

constexpr std::int64_t GRAIN = 8;  // rows
constexpr double NEAREST = 1e-9;   // [m]

using Rows3f = Eigen::Matrix<float, 3, 3>;

/// Row k gives w_k / z of the ray (x, y, 1).
Rows3f inverse(const Vec3& a, const Vec3& b, const Vec3& c, double edge_on) {
    Mat3 rows;
    rows.row(0) = b.cross(c);
    rows.row(1) = c.cross(a);
    rows.row(2) = a.cross(b);
    const double volume = rows.row(0).dot(a), nearest = std::min({a.norm(), b.norm(), c.norm()});
    if (std::abs(volume) > edge_on * (b - a).cross(c - a).norm() * nearest) return (rows / volume).cast<float>();
    Rows3f frontal = Rows3f::Zero();
    frontal.col(2).setConstant(static_cast<float>(1 / std::max(a[2] + b[2] + c[2], 3 * NEAREST)));
    return frontal;
}

/// Where a coordinate along `size` texels lies between the centres of two.
struct Between {
    std::int64_t low, high;
    float share;  // of the higher one

    Between(float at, std::int64_t size) {
        at = at * static_cast<float>(size) - 0.5f;
        at = at > 0 ? std::min(at, static_cast<float>(size - 1)) : 0;  // NaN, of UVs beyond float, too
        low = static_cast<std::int64_t>(at);
        high = std::min(low + 1, size - 1);
        share = at - static_cast<float>(low);
    }
};

void read(const Texture& t, float u, float v, float* out, std::int64_t step) {
    const Between x(u, t.size), y(1 - v, t.size);
    const float* top = t.texel + y.low * t.size * t.channels;
    const float* bottom = t.texel + y.high * t.size * t.channels;
    const float ne = x.share * (1 - y.share), sw = (1 - x.share) * y.share, se = x.share * y.share,
                nw = (1 - x.share) * (1 - y.share);
    for (std::int64_t c = 0; c < t.channels; ++c)
        out[c * step] = nw * top[x.low * t.channels + c] + ne * top[x.high * t.channels + c] +
                        sw * bottom[x.low * t.channels + c] + se * bottom[x.high * t.channels + c];
}

/// What pixels of one face have in common.
struct Painted {
    Rows3f inverse;
    Eigen::Matrix<float, 2, 3> uv;
    const Texture* texture = nullptr;

    Painted(const PaintedMesh& m, std::int32_t f, double edge_on) {
        const auto corner = [&](int k) { return Vec3(m.vertices_camera.row(m.faces(f, k))); };
        inverse = toile::inverse(corner(0), corner(1), corner(2), edge_on);
        for (int k = 0; k < 3; ++k) uv.col(k) = m.uv.row(m.face_uv(f, k)).cast<float>();
        const auto* end = m.first_face.data() + m.first_face.size();
        texture = &m.textures[static_cast<std::size_t>(std::upper_bound(m.first_face.data(), end, f) - 1 -
                                                       m.first_face.data())];
    }
    void at(float x, float y, float* out, std::int64_t step) const {
        Eigen::Vector3f w = (inverse.col(0) * x + inverse.col(1) * y + inverse.col(2)).cwiseMax(0.0f);
        const float sum = w.sum();
        w = sum > 0 && std::isfinite(sum) ? Eigen::Vector3f(w / sum) : Eigen::Vector3f(1, 0, 0);
        read(*texture, uv.row(0).dot(w), uv.row(1).dot(w), out, step);
    }
};

void check(const PaintedMesh& m, const FaceIds& face, const Mat3& K, double edge_on) {
    check_mesh("paint", m.vertices_camera, m.faces, "vertices_camera", "F");
    check_finite("paint", "uv", m.uv);
    check_faces("paint", m.face_uv, m.uv.rows(), "face_uv", "uv");
    check_finite("paint", "K", K);
    require(K(0, 0) > 0 && K(1, 1) > 0 && K(1, 0) == 0 && K.row(2) == Eigen::RowVector3d(0, 0, 1),
            "paint: K is not a camera matrix");
    require(m.face_uv.rows() == m.faces.rows(),
            "paint: face_uv has " + std::to_string(m.face_uv.rows()) + " rows, F " + std::to_string(m.faces.rows()));
    require(face.size() == 0 || (face.minCoeff() >= -1 && face.maxCoeff() < m.faces.rows()),
            "paint: face has an index out of -1.." + std::to_string(m.faces.rows() - 1));
    require(m.first_face.size() > 0 && m.first_face[0] == 0 &&
                std::is_sorted(m.first_face.data(), m.first_face.data() + m.first_face.size()),
            "paint: first_face does not ascend from 0");
    require(m.textures.size() == static_cast<std::size_t>(m.first_face.size()),
            "paint: " + std::to_string(m.textures.size()) + " textures for " + std::to_string(m.first_face.size()) +
                " layers");
    for (const Texture& t : m.textures)
        require(t.size > 0 && t.channels > 0 && t.channels == m.textures[0].channels,
                "paint: textures are empty or differ in channels");
    require(edge_on >= 0 && edge_on < 1, "paint: edge_on is " + std::to_string(edge_on) + ", expected 0 to 1");
}

}  // namespace

Planes paint(const PaintedMesh& mesh, const FaceIds& face, const Mat3& K, double edge_on) {
    check(mesh, face, K, edge_on);
    const std::int64_t height = face.rows(), width = face.cols();
    Planes picture = Planes::Zero(mesh.textures[0].channels, height * width);
    parallel_for(height, [&](std::int64_t i) {
        const double y = (static_cast<double>(i) + 0.5 - K(1, 2)) / K(1, 1);
        std::int32_t known = -1;
        std::optional<Painted> painted;  // neighbours often see one face
        for (std::int64_t j = 0; j < width; ++j) {
            const std::int32_t f = face(i, j);
            if (f < 0) continue;
            if (f != known) painted.emplace(mesh, f, edge_on), known = f;
            const double x = (static_cast<double>(j) + 0.5 - K(0, 2) - K(0, 1) * y) / K(0, 0);
            painted->at(static_cast<float>(x), static_cast<float>(y), picture.data() + i * width + j, height * width);
        }
    }, GRAIN);
    return picture;
}

}  // namespace toile
