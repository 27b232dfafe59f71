// Where a picture of a mesh jumps, and how it changes as those places move: silhouettes and edges that occlude.
#pragma once
#include <vector>

#include "../base/pictures.h"

namespace toile {

/// Between pixels a and b, row * W + column, lies the point (1 - share) v_i + share v_j of the mesh's edge (i, j).
struct ContourPoint {
    std::int32_t a, b, i, j;
    double share;
    bool below;  ///< b lies below a, else to its right
};

/// A mesh, and what `raster` saw of it.
struct ContourView {
    FaceIds face;              ///< (H,W), -1 where empty
    Matrix depth;              ///< (H,W) [m]
    Vertices vertices_camera;  ///< (n,3) [m] in the camera's frame
    Faces faces;               ///< (m,3)
    Faces neighbours;          ///< (m,3) by `face_neighbours`
    Mat3 K;                    ///< last row 0 0 1, no distortion
    PixelMask of = {};         ///< (H,W): only contours beside these pixels are asked for; empty: all
};

/// The contours between pixels that are neighbours in a row or a column.
///
/// From one pixel's centre the surface that it sees is followed, face by face, towards the other centre. On the way it may end
/// at a border or turn back at a fold: there the picture jumps to what lies behind. A surface that goes on to the other centre
/// has no contour there, however small its faces are; nor has one that takes more than `most_faces`. Of two surfaces that both
/// end, the nearer one's end counts (of equally near ones that of a); where neither ends, as where they cross, there is none.
/// What lies nearer than `near_plane` [m] counts as if it lay there. Bits do not depend on the number of threads.
/// Throws InputError for a bad mesh, K or near plane, an index out of range, arrays that do not fit.
class Contours {
public:
    static constexpr int most_faces = 64;

    Contours(const ContourView& view, double near_plane);

    const std::vector<ContourPoint>& points() const { return points_; }

    /// The slope (n,3) of a loss by the vertices, through the motion of the contours on the image: of a picture (C,H*W) and the
    /// loss' slope g by it. As a contour between a and b goes one pixel towards b, the loss grows by the sum of
    /// 0.5 (g_a + g_b) (I_a - I_b) over the channels; a difference that is not finite, as of depth beside emptiness, counts as 0.
    /// Throws InputError for other sizes.
    /// Source: S. Pidhorskyi et al., Rasterized edge gradients, ECCV 2024, of contours in place of pixels.
    Vertices gradient(const Eigen::Ref<const Planes>& picture, const Eigen::Ref<const Planes>& g) const;

private:
    Vertices vertices_;
    Mat3 K_;
    double near_;
    Eigen::Index pixels_;
    std::vector<ContourPoint> points_;
};

}  // namespace toile
