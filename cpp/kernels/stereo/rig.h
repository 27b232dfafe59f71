// The cameras as the solver needs them: who is compared with whom, and how deep each pixel may lie.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "kernels/stereo.h"
#include "kernels/stereo/picture.h"
#include "kernels/stereo/window.h"

namespace toile::stereo {

/// Inverse depths that a pixel may have; none where high is 0.
struct Bounds {
    float low = 0, high = 0;
};

/// One camera at one level of the pyramid.
struct View {
    Picture picture;
    Mat3 K;                   ///< of this level
    Eigen::Matrix4d T;        ///< camera from world
    std::vector<Pair> pairs;  ///< with the cameras that it is compared with, best angle first

    Vec3 centre() const { return -T.topLeftCorner<3, 3>().transpose() * T.topRightCorner<3, 1>(); }
};

/// A point near what the cameras look at, and the distance from it that masks leave.
struct Scene {
    Vec3 centre;
    double radius;
};

/// K of a picture `level` times halved; pixel centres lie at halves on every level.
Mat3 halved(const Mat3& K, int level);

/// By the masks, of the cameras whose masks are not empty.
Scene scene_of_masks(const std::vector<View>& views);

/// By depth ranges (C,2).
Scene scene_of_ranges(const std::vector<View>& views, const Matrix& ranges);

/// For each camera those nearest to a good angle, seen from the scene's centre.
std::vector<std::vector<int>> choose_sources(const std::vector<View>& views, const Scene& scene,
                                             const StereoOptions& options);

Pair make_pair(const View& from, const View& to, int to_index);

/// Of each pixel of a view, by its depth range or, where that is (0,0), by the other views' masks.
std::vector<Bounds> bound_depths(const std::vector<View>& views, std::size_t own, const Scene& scene,
                                 const Eigen::Vector2d& range);

}  // namespace toile::stereo
