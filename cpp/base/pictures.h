// Pictures as the kernels pass them.
#pragma once
#include "types.h"

namespace toile {

using FaceIds =
    Eigen::Matrix<std::int32_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;        ///< (H,W), -1 where empty
using PixelMask = Eigen::Matrix<bool, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;  ///< (H,W)
using Planes = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;    ///< (C,H*W)

}  // namespace toile
