// Which points a camera sees beside a surface whose depths it holds, and what its picture says there.
#pragma once
#include <cstdint>

#include "../base/types.h"

namespace toile {

/// An OpenCV camera: pixel (0,0) has its centre at (0.5, 0.5).
struct Camera {
    Mat3 K;
    Vector distortion;               ///< (5,) k1 k2 p1 p2 k3
    Eigen::Matrix4d T_camera_world;  ///< rotation and translation
};

struct Sight {
    Matrix uv;         ///< (n,2) [px]
    Vector weight;     ///< (n,) cosine between normal and view where the point is visible, else 0
    Vector clearance;  ///< (n,) by how far the point lies before the surface [m]: +inf where the picture shows none,
                       ///< -inf outside of the picture
};

/// `depth` (H,W) [m], +inf where empty. Visible is what lies at most `tolerance` / cosine [m] behind the surface, and
/// faces the camera by more than `min_cosine`.
Sight visibility(const Vertices& points, const Vertices& normals, const Camera& camera,
                 const Eigen::Ref<const Matrix>& depth, double tolerance, double min_cosine);

/// A picture (H,W,C), channels side by side.
struct Picture {
    const float* values;
    std::int64_t height, width, channels;
};

using Readings = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Bilinear values (n,C) at pixels `uv` (n,2); beyond the outermost pixels' centres the nearest one's.
Readings bilinear(const Picture& picture, const Eigen::Ref<const Matrix>& uv);

}  // namespace toile
