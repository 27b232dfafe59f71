// Face-id and depth buffers of a triangle mesh in an OpenCV camera: for pictures, visibility votes and the avatar.
#pragma once
#include "../base/types.h"

namespace toile {

using FaceImage = Eigen::Matrix<std::int32_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

struct RasterOptions {
    bool barycentric = false;  ///< also return perspective-correct barycentrics
    double near_plane = 1e-9;  ///< what lies at z < near_plane is clipped away [m]; depth is double, so it may be tiny
};

struct RasterResult {
    FaceImage face;        ///< (H,W) face index, -1 where no face covers the pixel's centre
    Matrix depth;          ///< (H,W) z in the camera's frame [m], +infinity where empty
    Vertices barycentric;  ///< (H*W,3) row i*W + j is pixel (i,j), zero where empty; (0,3) unless asked for
};

/// Rasterises both sides of every face at pixel centres; pixel (row i, column j) has its centre at (j + 0.5, i + 0.5).
///
/// `vertices_camera` (n,3) [m] in the camera's frame, x right, y down, z forward; K (3,3) with last row 0 0 1, no
/// distortion. Corners are snapped to 1/4096 px and coverage is decided in integers by the top-left rule: a centre on
/// or near a shared edge belongs to exactly one of its faces. Depth is that of the face's own plane (not snapped);
/// equal depths go to the lower face index. Bits do not depend on the number of threads.
/// Throws InputError for a bad mesh, K or size (1 to 32768 a side).
RasterResult raster(const Vertices& vertices_camera, const Faces& F, const Mat3& K, int height, int width,
                    const RasterOptions& options = {});

}  // namespace toile
