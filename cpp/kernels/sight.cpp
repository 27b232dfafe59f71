#include "kernels/sight.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

/// Ideal normalised coordinates to distorted ones (Brown 1971, OpenCV's order of coefficients).
void distort(double& x, double& y, const Vector& k) {
    const double r2 = x * x + y * y, xy = 2 * x * y, radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    x = x * radial + k[2] * xy + k[3] * (r2 + 2 * x * x);
    y = y * radial + k[2] * (r2 + 2 * y * y) + k[3] * xy;
}

void check_camera(const Camera& camera) {
    check_finite("visibility", "K", camera.K);
    check_finite("visibility", "T_camera_world", camera.T_camera_world);
    require(camera.distortion.size() == 5,
            "visibility: distortion has " + std::to_string(camera.distortion.size()) + " entries, expected 5");
    check_finite("visibility", "distortion", camera.distortion);
}

}  // namespace

Sight visibility(const Vertices& points, const Vertices& normals, const Camera& camera,
                 const Eigen::Ref<const Matrix>& depth, double tolerance, double min_cosine) {
    require(points.rows() == normals.rows(), "visibility: normals has " + std::to_string(normals.rows()) +
                                                 " rows, points " + std::to_string(points.rows()));
    check_points("visibility", "points", points);
    check_finite("visibility", "normals", normals);
    check_camera(camera);
    require(tolerance >= 0 && std::isfinite(tolerance),
            "visibility: tolerance is " + std::to_string(tolerance) + ", expected a length >= 0");
    require(min_cosine > 0 && min_cosine <= 1,
            "visibility: min_cosine is " + std::to_string(min_cosine) + ", expected 0 to 1");
    const Mat3 &K = camera.K, R = camera.T_camera_world.topLeftCorner<3, 3>();
    const Vec3 t = camera.T_camera_world.topRightCorner<3, 1>(), centre = -R.transpose() * t;
    Sight out{Matrix(points.rows(), 2), Vector(points.rows()), Vector(points.rows())};
    parallel_for(points.rows(), [&](std::int64_t i) {
        const Vec3 world = points.row(i), p = R * world + t;
        const double z = std::abs(p[2]) < 1e-12 ? 1e-12 : p[2];
        double x = p[0] / z, y = p[1] / z;
        distort(x, y, camera.distortion);
        const double u = K(0, 0) * x + K(0, 1) * y + K(0, 2), v = K(1, 0) * x + K(1, 1) * y + K(1, 2);
        out.uv(i, 0) = u;
        out.uv(i, 1) = v;
        double clearance = -infinity;
        const bool inside =
            u >= 0 && v >= 0 && u < static_cast<double>(depth.cols()) && v < static_cast<double>(depth.rows());
        if (p[2] > 0 && inside) clearance = depth(static_cast<Eigen::Index>(v), static_cast<Eigen::Index>(u)) - p[2];
        out.clearance[i] = clearance;
        const Vec3 ray = centre - world;
        const double cosine = ray.dot(normals.row(i)) / std::max(ray.norm(), 1e-12);
        const bool visible = cosine > min_cosine && clearance > -tolerance / cosine && std::isfinite(clearance);
        out.weight[i] = visible ? cosine : 0;
    }, 1024);
    return out;
}

Readings bilinear(const Picture& picture, const Eigen::Ref<const Matrix>& uv) {
    const auto [values, height, width, channels] = picture;
    require(height >= 2 && width >= 2, "bilinear: the picture is " + std::to_string(height) + " x " +
                                           std::to_string(width) + " pixels, expected at least 2 x 2");
    require(uv.cols() == 2, "bilinear: uv has " + std::to_string(uv.cols()) + " columns, expected 2");
    Readings out(uv.rows(), channels);
    const auto place = [](double at, std::int64_t size) {
        return at > 0.5 ? std::min(at - 0.5, static_cast<double>(size) - 1.001) : 0;  // 0 for what is no number
    };
    parallel_for(uv.rows(), [&, values = values, height = height, width = width, channels = channels](std::int64_t n) {
        const double x = place(uv(n, 0), width), y = place(uv(n, 1), height);
        const auto j = static_cast<std::int64_t>(x), i = static_cast<std::int64_t>(y);
        const float a = static_cast<float>(y - static_cast<double>(i));
        const float b = static_cast<float>(x - static_cast<double>(j));
        const float* upper = values + (i * width + j) * channels;
        const float* lower = upper + width * channels;
        for (std::int64_t c = 0; c < channels; ++c)
            out(n, c) = (1 - a) * ((1 - b) * upper[c] + b * upper[channels + c]) +
                        a * ((1 - b) * lower[c] + b * lower[channels + c]);
    }, 1024);
    return out;
}

}  // namespace toile
