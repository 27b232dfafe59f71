// Depth and normals from calibrated pictures: multi-view PatchMatch, and the fusion of its maps into points.
#pragma once
#include <cstdint>
#include <vector>

#include "../base/types.h"

namespace toile {

/// An ideal OpenCV camera, no distortion: pixel (0,0) has its centre at (0.5, 0.5).
struct StereoCamera {
    Mat3 K;
    Eigen::Matrix4d T_camera_world;
    int height, width;
};

/// C pictures side by side in (C,H,W), each from the upper left corner on.
struct StereoPictures {
    const float* grey;         ///< 0 to 255
    const std::uint8_t* mask;  ///< not 0: the person
    int height, width;
};

struct StereoOptions {
    int sources = 4;            ///< other cameras that a picture is compared with, nearest in angle
    int best = 2;               ///< of these the best count, pixel by pixel
    double max_angle = 1.2;     ///< between two cameras' rays, beyond which they are not compared [rad]
    int coarsest = 128;         ///< longer side of the coarsest level, at least half of it [px]
    int start_iterations = 6;   ///< of the coarsest level without the other cameras' depths
    int coarse_iterations = 3;  ///< of every other round but the finest's
    int iterations = 2;         ///< of the finest level
    int refinements = 2;        ///< of depth and slopes on the bent surface, two Gauss-Newton steps each
    double spacing = 2;         ///< between the samples of a window, 6 to a side [px]
    double colour = 16;         ///< difference of grey at which a sample counts half
    double noise = 0.5;         ///< of grey values, standard deviation: fainter textures match anything
    double consistency = 0.3;   ///< cost of a depth that another camera's contradicts
    double contradiction = 2;   ///< disparity from which on depths contradict one another wholly [px]
    double max_cost = 0.6;      ///< 1 - correlation; beyond there is a hole
    double agreement = 1;       ///< disparity up to which depths agree [px]
    int min_views = 1;          ///< other cameras whose depths have to agree
    std::uint64_t seed = 0;
};

/// Why a pixel has no depth.
enum class Hole : std::uint8_t {
    none,          ///< it has one
    masked,        ///< outside of the mask, or of what the other masks leave
    saturated,     ///< without texture, black or white
    untextured,    ///< its contrast is that of noise
    unmatched,     ///< no other picture looks alike
    inconsistent,  ///< too few other cameras say the same
};

/// (C,H,W), NaN in holes.
struct StereoMaps {
    std::vector<float> depth;        ///< z in the camera's frame [m]
    std::vector<float> normal;       ///< (C,H,W,3) unit, in the world, towards the camera
    std::vector<float> confidence;   ///< 0 to 1, 0 in holes
    std::vector<std::uint8_t> hole;  ///< Hole
};

/// Multi-view PatchMatch: planes a pixel, spread over a checkerboard from coarse to fine.
///
/// A plane is an inverse depth and its slopes, linear in the picture. Its cost is 1 - weighted normalised correlation of a
/// window of 32 samples, the mean over the `best` of the `sources`, plus `consistency` where their depths contradict it.
/// `ranges` (C,2): nearest and farthest depth [m]; where it is (0,0) the masks' visual hull bounds each pixel.
/// Bits do not depend on the number of threads. Throws InputError. Galliani, Lasinger, Schindler 2015.
class StereoSolver {
public:
    StereoSolver(std::vector<StereoCamera> cameras, const StereoOptions& options);
    StereoMaps solve(const StereoPictures& pictures, const Matrix& ranges) const;
    const std::vector<StereoCamera>& cameras() const { return cameras_; }

private:
    std::vector<StereoCamera> cameras_;
    StereoOptions options_;
};

struct FuseOptions {
    double agreement = 1;     ///< disparity up to which depths are of one point [px]
    double min_cosine = 0.5;  ///< least agreement of their normals
    int min_views = 2;        ///< cameras that a point needs
};

struct FusedPoints {
    Vertices points, normals;  ///< (n,3) [m], unit
    Vector confidence;         ///< (n,) 0 to 1
    Indices views;             ///< (n,) cameras that agree
};

/// Points of depth maps (C,H,W) as StereoSolver gives them, each the mean of the pixels that agree on it.
FusedPoints fuse_depths(const std::vector<StereoCamera>& cameras, const float* depth, const float* normal,
                        const float* confidence, int height, int width, const FuseOptions& options);

}  // namespace toile
