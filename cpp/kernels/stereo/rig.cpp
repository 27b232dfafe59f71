#include "kernels/stereo/rig.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "base/parallel.h"

namespace toile::stereo {

namespace {

constexpr double GOOD_ANGLE = 0.3;  // [rad]: less makes depth vague, more makes windows differ
constexpr int STEPS = 192;          // along a ray through the scene
constexpr int MASKS_A_DENIAL = 8;   // one mask in so many may be wrong

/// Centre and half the diagonal of the mask's box [px].
struct Extent {
    Eigen::Vector2d centre{0, 0};
    double radius = 0;
    bool empty = true;
};

Extent extent_of(const Picture& picture) {
    int left = picture.width, right = -1, top = picture.height, bottom = -1;
    for (int y = 0; y < picture.height; ++y)
        for (int x = 0; x < picture.width; ++x) {
            if (!picture.mask[picture.index(x, y)]) continue;
            left = std::min(left, x), right = std::max(right, x), top = std::min(top, y), bottom = std::max(bottom, y);
        }
    if (right < 0) return {};
    const Eigen::Vector2d low(left, top), high(right + 1, bottom + 1);
    return {0.5 * (low + high), 0.5 * (high - low).norm(), false};
}

Vec3 ray(const View& view, double u, double v) {
    return view.T.topLeftCorner<3, 3>().transpose() * (view.K.inverse() * Vec3(u, v, 1));
}

}  // namespace

Mat3 halved(const Mat3& K, int level) {
    Mat3 out = K;
    out.topRows<2>() *= std::ldexp(1.0, -level);
    return out;
}

Scene scene_of_masks(const std::vector<View>& views) {
    std::vector<Extent> extents;
    Mat3 normal = Mat3::Zero();
    Vec3 right = Vec3::Zero();
    for (const View& view : views) {
        extents.push_back(extent_of(view.picture));
        if (extents.back().empty) continue;
        const Vec3 d = ray(view, extents.back().centre[0], extents.back().centre[1]).normalized();
        const Mat3 across = Mat3::Identity() - d * d.transpose();
        normal += across;
        right += across * view.centre();
    }
    const Vec3 centre = normal.ldlt().solve(right);
    double radius = 0;
    for (std::size_t c = 0; c < views.size(); ++c)
        if (!extents[c].empty)
            radius = std::max(radius, extents[c].radius / views[c].K(0, 0) * (views[c].centre() - centre).norm());
    return {centre, 1.1 * radius};
}

Scene scene_of_ranges(const std::vector<View>& views, const Matrix& ranges) {
    Vec3 centre = Vec3::Zero();
    double radius = 0;
    for (std::size_t c = 0; c < views.size(); ++c) {
        const auto i = static_cast<Eigen::Index>(c);
        const View& view = views[c];
        centre += view.centre() + 0.5 * (ranges(i, 0) + ranges(i, 1)) * ray(view, view.K(0, 2), view.K(1, 2));
        radius = std::max(radius, 0.5 * (ranges(i, 1) - ranges(i, 0)));
    }
    return {centre / static_cast<double>(views.size()), radius};
}

std::vector<std::vector<int>> choose_sources(const std::vector<View>& views, const Scene& scene,
                                             const StereoOptions& options) {
    std::vector<bool> dark;
    for (const View& view : views) dark.push_back(extent_of(view.picture).empty);
    std::vector<std::vector<int>> sources(views.size());
    for (std::size_t c = 0; c < views.size(); ++c) {
        std::vector<std::pair<double, int>> ranked;
        for (std::size_t s = 0; s < views.size() && !dark[c]; ++s) {
            const Vec3 a = scene.centre - views[c].centre(), b = scene.centre - views[s].centre();
            const double angle = std::atan2(a.cross(b).norm(), a.dot(b));
            if (s != c && !dark[s] && angle > 1e-6 && angle < options.max_angle)
                ranked.emplace_back(std::abs(std::log(angle / GOOD_ANGLE)), static_cast<int>(s));
        }
        std::sort(ranked.begin(), ranked.end());
        for (std::size_t k = 0; k < std::min<std::size_t>(ranked.size(), options.sources); ++k)
            sources[c].push_back(ranked[k].second);
    }
    return sources;
}

Pair make_pair(const View& from, const View& to, int to_index) {
    const Eigen::Matrix4d T = to.T * from.T.inverse();
    Mat3 to_index_space = Mat3::Identity(), from_index_space = Mat3::Identity();  // pixel (0,0) at (0,0)
    to_index_space(0, 2) = to_index_space(1, 2) = -0.5;
    from_index_space(0, 2) = from_index_space(1, 2) = 0.5;
    const Mat3 K = to_index_space * to.K;
    const Mat3 A = K * T.topLeftCorner<3, 3>() * from.K.inverse() * from_index_space;
    const Vec3 b = K * T.topRightCorner<3, 1>();
    Pair pair{to_index, {}, {}};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) pair.A[i][j] = static_cast<float>(A(i, j));
        pair.b[i] = static_cast<float>(b[i]);
    }
    return pair;
}

std::vector<Bounds> bound_depths(const std::vector<View>& views, std::size_t own, const Scene& scene,
                                 const Eigen::Vector2d& range) {
    const View& view = views[own];
    const Picture& picture = view.picture;
    std::vector<Bounds> bounds(picture.mask.size());
    const bool given = range[1] > 0;
    const Vec3 middle = view.T.topLeftCorner<3, 3>() * scene.centre + view.T.topRightCorner<3, 1>();
    const double near = given ? range[0] : std::max(middle[2] - scene.radius, 1e-3 * scene.radius);
    const double far = given ? range[1] : middle[2] + scene.radius;
    if (!(far > near)) return bounds;
    std::vector<Pair> others;
    for (std::size_t s = 0; s < views.size() && !given; ++s)
        if (s != own && !extent_of(views[s].picture).empty)
            others.push_back(make_pair(view, views[s], static_cast<int>(s)));
    const double step = (far - near) / STEPS;
    const auto left = [&](float x, float y, float w) {
        int seen = 0, denied = 0;
        for (const Pair& pair : others) {
            const Warp warp(pair, x, y, {w, 0, 0});
            const Picture& other = views[pair.view].picture;
            const float u = warp.u + 0.5F, v = warp.v + 0.5F;
            if (!(warp.q[2] > 0 && u >= 0 && v >= 0 && u < static_cast<float>(other.width) &&
                  v < static_cast<float>(other.height)))
                continue;
            ++seen;
            if (other.mask[other.index(static_cast<int>(u), static_cast<int>(v))]) continue;
            if (++denied * MASKS_A_DENIAL > static_cast<int>(others.size())) return false;  // whatever the rest say
        }
        return denied * MASKS_A_DENIAL <= seen;
    };
    parallel_for(picture.height, [&](std::int64_t y) {
        for (int x = 0; x < picture.width; ++x) {
            const std::size_t at = picture.index(x, static_cast<int>(y));
            if (!picture.mask[at]) continue;
            const auto empty = [&](int k) {
                const double z = near + (k + 0.5) * step;
                return !given && !left(static_cast<float>(x), static_cast<float>(y), static_cast<float>(1 / z));
            };
            int first = 0, last = STEPS - 1;
            while (first < STEPS && empty(first)) ++first;
            if (first == STEPS) continue;
            while (empty(last)) --last;
            const double slack = given ? 0 : 1.5;
            bounds[at] = {static_cast<float>(1 / (near + (last + 1 + slack) * step)),
                          static_cast<float>(1 / std::max(near + (first - slack) * step, 0.5 * near))};
        }
    }, 1);
    return bounds;
}

}  // namespace toile::stereo
