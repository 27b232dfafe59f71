// Colours of a picture whose faces are known: textures read where each pixel's ray meets its face.
#pragma once
#include <vector>

#include "../base/pictures.h"

namespace toile {

/// Texels (size, size, channels) in C order, read and not kept; texel (r, c) has its centre at u = (c + .5) / size,
/// v = 1 - (r + .5) / size.
struct Texture {
    const float* texel = nullptr;
    std::int64_t size = 0, channels = 0;
};

/// One mesh of several textures: layer k owns the faces from first_face[k] on.
struct PaintedMesh {
    Vertices vertices_camera;       ///< (n,3) [m] in the camera's frame
    Faces faces;                    ///< (m,3)
    Matrix uv;                      ///< (t,2)
    Faces face_uv;                  ///< (m,3)
    Indices first_face;             ///< (L,) ascending, the first 0
    std::vector<Texture> textures;  ///< (L,) of one number of channels
};

/// The picture (C, H*W), row i*W + j of `face` in C order, 0 where face (H,W) is -1. With V = (v_0 v_1 v_2) of a pixel's
/// face and the ray d = K^-1 (j + .5, i + .5, 1), z d = V w gives w = z V^-1 d and sum_k w_k = 1 gives z; w < 0, as snapped
/// corners can give, counts as 0. The texture is read bilinearly at sum_k w_k uv_k, and is constant beyond its outermost
/// texel centres. Of a face whose plane meets the eye to within the sine `edge_on` all points count as its middle.
/// Bits do not depend on the number of threads. Throws InputError for a bad mesh, K, index or texture.
Planes paint(const PaintedMesh& mesh, const FaceIds& face, const Mat3& K, double edge_on = 1e-3);

}  // namespace toile
