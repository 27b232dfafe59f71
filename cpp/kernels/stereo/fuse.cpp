#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "base/errors.h"
#include "kernels/stereo.h"

namespace toile {

namespace {

using Vec3f = Eigen::Vector3f;

constexpr double FACING = 0.2;  // cosine between a point's normal and the direction to a camera that may judge it

/// A camera's maps, and which of its pixels have gone into a point.
struct Map {
    Mat3 K, inverse, R;
    Vec3 t, centre;
    int height, width, stride;
    const float *depth, *normal, *confidence;
    std::vector<char> used;

    std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * stride + x; }
    Vec3 point(int x, int y) const {
        return R.transpose() * (depth[index(x, y)] * (inverse * Vec3(x + 0.5, y + 0.5, 1)) - t);
    }
    Vec3 normal_at(std::size_t at) const { return Eigen::Map<const Vec3f>(normal + 3 * at).cast<double>(); }
};

std::vector<Map> maps_of(const std::vector<StereoCamera>& cameras, const float* depth, const float* normal,
                         const float* confidence, int height, int width) {
    std::vector<Map> maps;
    const std::size_t plane = static_cast<std::size_t>(height) * width;
    for (std::size_t c = 0; c < cameras.size(); ++c) {
        const StereoCamera& camera = cameras[c];
        const Mat3 R = camera.T_camera_world.topLeftCorner<3, 3>();
        const Vec3 t = camera.T_camera_world.topRightCorner<3, 1>();
        maps.push_back({camera.K, camera.K.inverse(), R, t, -R.transpose() * t, std::min(camera.height, height),
                        std::min(camera.width, width), width, depth + c * plane, normal + 3 * c * plane,
                        confidence + c * plane, std::vector<char>(plane, 0)});
    }
    return maps;
}

/// A weighted mean in the making.
struct Mean {
    Vec3 point = Vec3::Zero(), normal = Vec3::Zero();
    double weight = 0, doubt = 1;
    int views = 0;

    void add(const Vec3& p, const Vec3& n, double confidence) {
        const double w = confidence + 1e-3;
        point += w * p;
        normal += w * n;
        weight += w;
        doubt *= 1 - confidence;
        ++views;
    }
};

/// Of the cameras that face a point and have a depth there, do at least as many say that it lies on their surface as not?
bool upheld(const std::vector<Map>& maps, const Vec3& p, const Vec3& n, double agreement) {
    int agree = 0, others = 0;
    for (const Map& map : maps) {
        const Vec3 q = map.R * p + map.t, uv = map.K * q / q[2];
        const double cosine = n.dot((map.centre - p).normalized());
        if (!(cosine > FACING && q[2] > 0 && uv[0] >= 0 && uv[1] >= 0 && uv[0] < map.width && uv[1] < map.height))
            continue;
        const double depth = map.depth[map.index(static_cast<int>(uv[0]), static_cast<int>(uv[1]))];
        if (!(depth > 0)) continue;
        const double apart = std::abs(depth - q[2]) * cosine * map.K(0, 0) / q[2];  // across the surface [px]
        ++(apart < agreement ? agree : others);
    }
    return agree >= others;
}

}  // namespace

FusedPoints fuse_depths(const std::vector<StereoCamera>& cameras, const float* depth, const float* normal,
                        const float* confidence, int height, int width, const FuseOptions& options) {
    require(options.min_views >= 1,
            "fuse_depths: min_views is " + std::to_string(options.min_views) + ", expected at least 1");
    std::vector<Map> maps = maps_of(cameras, depth, normal, confidence, height, width);
    std::vector<Mean> found;
    std::vector<std::pair<std::size_t, std::size_t>> joined;  // map, pixel
    for (std::size_t c = 0; c < maps.size(); ++c) {
        Map& own = maps[c];
        for (int y = 0; y < own.height; ++y)
            for (int x = 0; x < own.width; ++x) {
                const std::size_t at = own.index(x, y);
                if (own.used[at] || !(own.depth[at] > 0)) continue;
                const Vec3 p = own.point(x, y), n = own.normal_at(at);
                Mean mean;
                mean.add(p, n, own.confidence[at]);
                joined.assign(1, {c, at});
                for (std::size_t s = 0; s < maps.size(); ++s) {
                    const Map& map = maps[s];
                    if (s == c || n.dot(map.centre - p) <= 0) continue;
                    const Vec3 q = map.R * p + map.t, uv = map.K * q / q[2];
                    if (!(q[2] > 0 && uv[0] >= 0 && uv[1] >= 0 && uv[0] < map.width && uv[1] < map.height)) continue;
                    const int u = static_cast<int>(uv[0]), v = static_cast<int>(uv[1]);
                    const std::size_t there = map.index(u, v);
                    if (!(map.depth[there] > 0) || n.dot(map.normal_at(there)) < options.min_cosine) continue;
                    // the other pixel's point, seen from here
                    const Vec3 other = map.point(u, v);
                    const double apart = std::abs(n.dot(other - p));  // across the surface, not along it
                    const double pixel = own.depth[at] / own.K(0, 0);
                    if (apart > options.agreement * pixel) continue;
                    mean.add(other, map.normal_at(there), map.confidence[there]);
                    joined.emplace_back(s, there);
                }
                if (mean.views < options.min_views) continue;
                if (!upheld(maps, mean.point / mean.weight, mean.normal.normalized(), options.agreement)) continue;
                for (const auto& [s, pixel] : joined) maps[s].used[pixel] = 1;
                found.push_back(mean);
            }
    }
    const auto n = static_cast<Eigen::Index>(found.size());
    FusedPoints out{Vertices(n, 3), Vertices(n, 3), Vector(n), Indices(n)};
    for (Eigen::Index i = 0; i < n; ++i) {
        const Mean& mean = found[i];
        out.points.row(i) = (mean.point / mean.weight).transpose();
        out.normals.row(i) = mean.normal.normalized().transpose();
        out.confidence[i] = 1 - mean.doubt;
        out.views[i] = mean.views;
    }
    return out;
}

}  // namespace toile
