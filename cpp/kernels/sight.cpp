#include "kernels/sight.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <string>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

/// Brown 1971, OpenCV's order of coefficients, as far as r radial(r) grows. What lies farther out is moved as it is where
/// that ends: it would fold back into the picture.
class Lens {
public:
    explicit Lens(const Vector& k) : k_(k) {
        Mat3 companion;  // d (r radial) / dr = 0: u^3 + 3 k1 u^2 + 5 k2 u + 7 k3 = 0 of u = 1 / r^2
        companion << -3 * k[0], -5 * k[1], -7 * k[4], 1, 0, 0, 0, 1, 0;
        for (const std::complex<double>& u : companion.eigenvalues())
            if (u.imag() == 0 && u.real() > 0) limit_ = std::max(limit_, std::sqrt(u.real()));
    }
    bool shows(const Eigen::Vector2d& ideal) const { return ideal.norm() * limit_ <= 1; }
    /// Ideal normalised coordinates to distorted ones.
    Eigen::Vector2d distort(const Eigen::Vector2d& ideal) const {
        const double share = 1 / std::max(1.0, ideal.norm() * limit_), x = share * ideal[0], y = share * ideal[1];
        const double r2 = x * x + y * y, xy = 2 * x * y, radial = 1 + r2 * (k_[0] + r2 * (k_[1] + r2 * k_[4]));
        return {x * radial + k_[2] * xy + k_[3] * (r2 + 2 * x * x) + (1 - share) * ideal[0],
                y * radial + k_[2] * (r2 + 2 * y * y) + k_[3] * xy + (1 - share) * ideal[1]};
    }

private:
    const Vector& k_;
    double limit_ = 0;  // 1 / the least such r
};

void check_camera(const char* kernel, const Camera& camera) {
    const std::string name = kernel;
    check_finite(name, "K", camera.K);
    check_finite(name, "T_camera_world", camera.T_camera_world);
    require(camera.distortion.size() == 5,
            name + ": distortion has " + std::to_string(camera.distortion.size()) + " entries, expected 5");
    check_finite(name, "distortion", camera.distortion);
}

void check_picture(const char* kernel, const Picture& picture) {
    require(picture.height >= 2 && picture.width >= 2,
            std::string(kernel) + ": the picture is " + std::to_string(picture.height) + " x " +
                std::to_string(picture.width) + " pixels, expected at least 2 x 2");
}

/// Where a point falls in a picture, and by how far it lies before the surface there.
struct Seen {
    double u = 0, v = 0, clearance = -infinity;
};

/// A camera that looks at points, beside the depths of a surface.
class Eye {
public:
    Eye(const Camera& camera, const Eigen::Ref<const Matrix>& depth, double tolerance, double min_cosine)
        : camera_(camera), lens_(camera.distortion), R_(camera.T_camera_world.topLeftCorner<3, 3>()),
          t_(camera.T_camera_world.topRightCorner<3, 1>()), centre_(-R_.transpose() * t_), depth_(depth),
          tolerance_(tolerance), min_cosine_(min_cosine) {}

    Seen look(const Vec3& world) const {
        const Mat3& K = camera_.K;
        const Vec3 p = R_ * world + t_;
        const double z = std::abs(p[2]) < 1e-12 ? 1e-12 : p[2];
        const Eigen::Vector2d ideal(p[0] / z, p[1] / z), at = lens_.distort(ideal);
        Seen out{K(0, 0) * at[0] + K(0, 1) * at[1] + K(0, 2), K(1, 0) * at[0] + K(1, 1) * at[1] + K(1, 2)};
        const bool inside = lens_.shows(ideal) && out.u >= 0 && out.v >= 0 &&
                            out.u < static_cast<double>(depth_.cols()) && out.v < static_cast<double>(depth_.rows());
        if (p[2] > 0 && inside)
            out.clearance = depth_(static_cast<Eigen::Index>(out.v), static_cast<Eigen::Index>(out.u)) - p[2];
        return out;
    }

    double cosine(const Vec3& world, const Vec3& normal) const {
        const Vec3 ray = centre_ - world;
        return ray.dot(normal) / std::max(ray.norm(), 1e-12);
    }

    /// The cosine where the point is visible, else 0.
    double weight(const Seen& seen, double cosine) const {
        const bool visible =
            cosine > min_cosine_ && seen.clearance > -tolerance_ / cosine && std::isfinite(seen.clearance);
        return visible ? cosine : 0;
    }

private:
    const Camera& camera_;
    Lens lens_;
    Mat3 R_;
    Vec3 t_, centre_;
    Eigen::Ref<const Matrix> depth_;
    double tolerance_, min_cosine_;
};

/// The four pixels about a place (column u, row v), and their weights.
class Cell {
public:
    Cell(const Picture& picture, double u, double v) : channels_(picture.channels) {
        const auto place = [](double at, std::int64_t size) {
            return at > 0.5 ? std::min(at - 0.5, static_cast<double>(size) - 1.001) : 0;  // 0 for what is no number
        };
        const double x = place(u, picture.width), y = place(v, picture.height);
        const auto j = static_cast<std::int64_t>(x), i = static_cast<std::int64_t>(y);
        a_ = static_cast<float>(y - static_cast<double>(i));
        b_ = static_cast<float>(x - static_cast<double>(j));
        upper_ = picture.values + (i * picture.width + j) * channels_;
        lower_ = upper_ + picture.width * channels_;
    }
    float operator[](std::int64_t c) const {
        return (1 - a_) * ((1 - b_) * upper_[c] + b_ * upper_[channels_ + c]) +
               a_ * ((1 - b_) * lower_[c] + b_ * lower_[channels_ + c]);
    }

private:
    std::int64_t channels_;
    float a_, b_;
    const float *upper_, *lower_;
};

void check_views(const char* kernel, const std::vector<View>& views, const Vertices& points, const Vertices& normals,
                 std::int64_t channels) {
    require(points.rows() == normals.rows(), std::string(kernel) + ": normals has " + std::to_string(normals.rows()) +
                                                 " rows, points " + std::to_string(points.rows()));
    check_points(kernel, "points", points);
    check_finite(kernel, "normals", normals);
    for (const View& view : views) {
        check_camera(kernel, view.camera);
        check_picture(kernel, view.picture);
        require(view.picture.channels == channels, std::string(kernel) + ": a picture has " +
                                                       std::to_string(view.picture.channels) + " channels, expected " +
                                                       std::to_string(channels));
    }
}

std::vector<Eye> eyes_of(const std::vector<View>& views, double tolerance, double min_cosine) {
    std::vector<Eye> eyes;
    for (const View& view : views) eyes.emplace_back(view.camera, view.depth, tolerance, min_cosine);
    return eyes;
}

}  // namespace

Vertices undistorted_view(const Vertices& points, const Camera& camera) {
    check_points("undistorted_view", "points", points);
    check_camera("undistorted_view", camera);
    const Mat3 R = camera.T_camera_world.topLeftCorner<3, 3>();
    const Vec3 t = camera.T_camera_world.topRightCorner<3, 1>();
    const Lens lens(camera.distortion);
    Vertices out(points.rows(), 3);
    parallel_for(points.rows(), [&](std::int64_t i) {
        constexpr double nearest = 1e-3;  // [m], what lies behind is not seen anyway
        const Vec3 p = R * points.row(i).transpose() + t;
        const double z = std::max(p[2], nearest);
        const Eigen::Vector2d at = lens.distort({p[0] / z, p[1] / z});
        out.row(i) << at[0] * z, at[1] * z, p[2];
    }, 4096);
    return out;
}

Sight visibility(const Vertices& points, const Vertices& normals, const Camera& camera,
                 const Eigen::Ref<const Matrix>& depth, double tolerance, double min_cosine) {
    require(points.rows() == normals.rows(), "visibility: normals has " + std::to_string(normals.rows()) +
                                                 " rows, points " + std::to_string(points.rows()));
    check_points("visibility", "points", points);
    check_finite("visibility", "normals", normals);
    check_camera("visibility", camera);
    require(tolerance >= 0 && std::isfinite(tolerance),
            "visibility: tolerance is " + std::to_string(tolerance) + ", expected a length >= 0");
    require(min_cosine > 0 && min_cosine <= 1,
            "visibility: min_cosine is " + std::to_string(min_cosine) + ", expected 0 to 1");
    const Eye eye(camera, depth, tolerance, min_cosine);
    Sight out{Matrix(points.rows(), 2), Vector(points.rows()), Vector(points.rows())};
    parallel_for(points.rows(), [&](std::int64_t i) {
        const Vec3 world = points.row(i);
        const Seen seen = eye.look(world);
        out.uv.row(i) << seen.u, seen.v;
        out.clearance[i] = seen.clearance;
        out.weight[i] = eye.weight(seen, eye.cosine(world, normals.row(i)));
    }, 1024);
    return out;
}

Readings bilinear(const Picture& picture, const Eigen::Ref<const Matrix>& uv) {
    check_picture("bilinear", picture);
    require(uv.cols() == 2, "bilinear: uv has " + std::to_string(uv.cols()) + " columns, expected 2");
    Readings out(uv.rows(), picture.channels);
    parallel_for(uv.rows(), [&](std::int64_t n) {
        const Cell cell(picture, uv(n, 0), uv(n, 1));
        for (std::int64_t c = 0; c < picture.channels; ++c) out(n, c) = cell[c];
    }, 1024);
    return out;
}

Matrix view_odds(const std::vector<View>& views, const Vertices& points, const Vertices& normals, int labels,
                 int column, const Indices& rival, const OddsOptions& o) {
    check_views("view_odds", views, points, normals, 2 * labels + 4);
    require(column >= 0 && column < labels, "view_odds: column is " + std::to_string(column));
    require(rival.size() == points.rows(), "view_odds: rival has " + std::to_string(rival.size()) + " entries");
    check_indices("view_odds", "rival", rival, labels);
    const std::vector<Eye> eyes = eyes_of(views, o.tolerance, o.min_cosine);
    Matrix out = Matrix::Zero(points.rows(), 5);
    parallel_for(points.rows(), [&](std::int64_t i) {
        const Vec3 world = points.row(i), normal = normals.row(i);
        for (std::size_t k = 0; k < views.size(); ++k) {
            const double cosine = eyes[k].cosine(world, normal);
            if (!o.free && !(cosine > o.min_cosine)) continue;
            const Seen seen = eyes[k].look(world);
            double weight = eyes[k].weight(seen, cosine);
            const bool floats = o.free && seen.clearance > o.floating;
            if (weight == 0 && !floats) continue;
            const Cell cell(views[k].picture, seen.u - views[k].corner[0], seen.v - views[k].corner[1]);
            if (floats) {
                out(i, 4) = std::max(out(i, 4), static_cast<double>(cell[2 * labels + 3]));
                if (cell[labels + column] > o.behind) weight = 0;
            }
            if (weight == 0) continue;
            double against = o.free ? 0 : cell[labels + rival[i]];
            for (int l = 0; o.free && l < labels; ++l)
                if (l != column) against += cell[labels + l];
            const double ratio = static_cast<double>(cell[column]) - cell[rival[i]];
            out(i, 0) += weight * std::clamp(ratio, -o.most, o.most);
            out(i, 1) += weight;
            out(i, 2) += weight * cell[labels + column];
            out(i, 3) += weight * against;
        }
    }, 256);
    return out;
}

namespace {

/// Place and trust of the edge in one profile's colours (m,3).
struct Edge {
    double at, trust;
};

Edge edge_in(const Vertices& rgb, const Vector& s, const EdgeOptions& o) {
    const Eigen::Index m = s.size();
    const double last = s[m - 1];
    Vec3 outer = Vec3::Zero(), inner = Vec3::Zero();
    int before = 0, after = 0;
    for (Eigen::Index j = 0; j < m; ++j) {
        if (!(std::abs(s[j]) > o.flank * last)) continue;
        if (s[j] < 0) outer += rgb.row(j), ++before;
        if (s[j] > 0) inner += rgb.row(j), ++after;
    }
    outer /= before;
    inner /= after;
    const Vec3 step = inner - outer;
    const double contrast = std::max(step.norm(), 1e-6);
    double off_line = 0, off_flank = 0, covered = 0;  // colours off the mixing line, ends that are mixed: print, folds
    for (Eigen::Index j = 0; j < m; ++j) {
        const Vec3 from = rgb.row(j).transpose() - outer;
        const double share = from.dot(step) / (contrast * contrast);
        off_line += (from - share * step).norm();
        if (std::abs(s[j]) > o.flank * last) off_flank += std::abs(share - (s[j] > 0));
        covered += std::clamp(share, 0.0, 1.0);
    }
    const auto size = static_cast<double>(m);
    const double disorder = off_line / size + off_flank / (before + after) * step.norm();
    const double at = (0.5 - covered / size) * (last - s[0]);
    const double faint = o.contrast / contrast, messy = disorder / contrast / o.disorder;
    return {at, std::abs(at) < o.shift * last ? std::exp(-faint * faint) * std::exp(-messy * messy) : 0};
}

}  // namespace

Matrix view_edges(const std::vector<View>& views, const Vertices& points, const Vertices& normals, int labels,
                  const Vector& s, const EdgeOptions& o) {
    check_views("view_edges", views, points, normals, 2 * labels + 4);
    check_finite("view_edges", "s", s);
    const Eigen::Index m = s.size();
    require(
        m >= 3 && o.flank >= 0 && o.flank < 1 && -s[0] > o.flank * s[m - 1] && s[m - 1] > 0 && points.rows() % m == 0,
        "view_edges: s has " + std::to_string(m) + " places for " + std::to_string(points.rows()) +
            " points, expected a profile about 0");
    const std::vector<Eye> eyes = eyes_of(views, o.tolerance, o.min_cosine);
    Matrix out = Matrix::Zero(points.rows() / m, 2);
    parallel_for(out.rows(), [&](std::int64_t p) {
        Vertices rgb(m, 3);
        for (std::size_t k = 0; k < views.size(); ++k) {
            double weight = 1;
            for (Eigen::Index j = 0; j < m && weight > 0; ++j) {
                const Vec3 world = points.row(p * m + j);
                const double cosine = eyes[k].cosine(world, normals.row(p * m + j));
                const Seen seen = cosine > o.min_cosine ? eyes[k].look(world) : Seen{};
                weight = std::min(weight, eyes[k].weight(seen, cosine));
                const Cell cell(views[k].picture, seen.u - views[k].corner[0], seen.v - views[k].corner[1]);
                for (int c = 0; c < 3; ++c) rgb(j, c) = cell[2 * labels + c];
            }
            if (weight == 0) continue;
            const Edge edge = edge_in(rgb, s, o);
            out(p, 0) += weight * edge.trust * edge.at;
            out(p, 1) += weight * edge.trust;
        }
    }, 8);
    return out;
}

}  // namespace toile
