// Which points a camera sees beside a surface whose depths it holds, and what its picture says there.
#pragma once
#include <cstdint>
#include <vector>

#include "../base/types.h"

namespace toile {

/// An OpenCV camera: pixel (0,0) has its centre at (0.5, 0.5).
struct Camera {
    Mat3 K;
    Vector distortion;               ///< (5,) k1 k2 p1 p2 k3
    Eigen::Matrix4d T_camera_world;  ///< rotation and translation
};

/// World points (n,3) in the camera's frame [m], moved across the view so that a camera without distortion sees each where
/// this one does.
Vertices undistorted_view(const Vertices& points, const Camera& camera);

struct Sight {
    Matrix uv;         ///< (n,2) [px]
    Vector weight;     ///< (n,) cosine between normal and view where the point is visible, else 0
    Vector clearance;  ///< (n,) by how far the point lies before the surface [m]: +inf where the picture shows none,
                       ///< -inf outside of the picture and of what the lens shows
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

/// One camera of a frame: what it sees of the surface, and its picture from pixel `corner` (column, row) on.
struct View {
    Camera camera;
    Eigen::Map<const Matrix> depth;  ///< (H,W) [m], +inf where empty
    Picture picture;
    Eigen::Vector2d corner;
};

/// Label ids (H,W), 0: none.
struct LabelImage {
    const std::uint8_t* values;
    std::int64_t height, width;
};

/// Blurred indicator (H,W,L) of each of the labels `ids`; `blur` [px] is the Gaussian's sigma. Beyond its border the picture
/// is mirrored.
std::vector<float> soft_labels(const LabelImage& image, const std::vector<std::uint8_t>& ids, double blur);

/// A picture as `view_odds` reads it (H,W,2L+4). `likelihood`: L values for each pixel that is `clear` (H,W), row by row, and
/// `rgb` (H,W,3); either may be null, and is zero then.
std::vector<float> evidence_picture(const LabelImage& image, const std::vector<std::uint8_t>& ids, const bool* clear,
                                    const float* likelihood, const std::uint8_t* rgb, double blur, double empty_blur);

struct OddsOptions {
    double tolerance = 0, min_cosine = 0;  ///< as `visibility` has them
    double floating = 0;                   ///< a point this far before the surface floats [m]
    double behind = 0;  ///< the label's share behind a floating point from which on a picture says nothing of it
    double most = 0;    ///< one picture's log likelihood ratio counts up to this
    bool free = false;  ///< points may float; every other label speaks against, not the rival alone
};

/// What views say of points for label `column` of L against each point's `rival`: columns are the log likelihood
/// ratios by colour, summed with the views' weights; the sum of the weights; the shares of the labels given, `column`
/// and what speaks against it, summed likewise; and of a floating point how empty the emptiest picture is, else 0.
/// A picture's 2L + 4 channels: log likelihoods, shares, RGB, emptiness.
Matrix view_odds(const std::vector<View>& views, const Vertices& points, const Vertices& normals, int labels,
                 int column, const Indices& rival, const OddsOptions& options);

struct EdgeOptions {
    double tolerance = 0, min_cosine = 0;  ///< as `visibility` has them
    double flank = 0;                      ///< share of the profile's half length beyond which its end colours are read
    double contrast = 0;                   ///< difference of RGB that makes an edge worth reading
    double disorder = 0;                   ///< share of it that prints and folds may add
    double shift = 0;                      ///< largest shift, as a share of the half length
};

/// Edges along profiles of m points each, from outside in at places s (m,) [m]: columns are the sums over the views
/// of weight * shift [m] and of the weights. Each view's profile is read as a mix of its ends' colours, whose sharp edge
/// would cover the same length. Pictures are as for `view_odds`.
Matrix view_edges(const std::vector<View>& views, const Vertices& points, const Vertices& normals, int labels,
                  const Vector& s, const EdgeOptions& options);

/// Bilinear values (n,C) at pixels `uv` (n,2); beyond the outermost pixels' centres the nearest one's.
Readings bilinear(const Picture& picture, const Eigen::Ref<const Matrix>& uv);

}  // namespace toile
