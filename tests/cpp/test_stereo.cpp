// Stereo from C++: what the sanitizers see.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "check.h"
#include "kernels/stereo.h"
#include "kernels/stereo/picture.h"

using namespace toile;

int main() {
    constexpr int side = 16;
    std::vector<float> grey;
    for (int k = 0; k < 2 * side * side; ++k) grey.push_back(static_cast<float>(37 * k % 251));

    LAW("a place has the pixel about it, and none beyond the picture or where it is no number");
    const stereo::Picture picture(side, side, std::vector<float>(grey.begin(), grey.begin() + side * side),
                                  std::vector<std::uint8_t>(side * side, 1));
    CHECK(picture.nearest(-0.5F, 0) == 0 && picture.nearest(15.4F, 2.6F) == 3 * side + 15);
    for (const float beyond : {-0.6F, 15.5F, -1e30F, 1e30F, INFINITY, NAN})
        CHECK(picture.nearest(beyond, 3) == -1 && picture.nearest(3, beyond) == -1 && !picture.person(beyond, 3));

    LAW("planes through another camera's centre, which falls nowhere in its picture, are tried without harm");
    Mat3 K;
    K << 2000, 0, 8, 0, 2000, 8, 0, 0, 1;
    std::vector<StereoCamera> cameras(2, {K, Eigen::Matrix4d::Identity(), side, side});
    cameras[1].T_camera_world(0, 3) = -0.5;
    cameras[1].T_camera_world(2, 3) = -1;  // as far ahead of the first as this one may look
    StereoOptions options;
    options.coarsest = side;
    options.max_angle = 3;
    Matrix ranges(2, 2);
    ranges << 1, 1 + 1e-6, 0.5, 2;
    const std::vector<std::uint8_t> mask(2 * side * side, 1);
    const StereoMaps maps = StereoSolver(cameras, options).solve({grey.data(), mask.data(), side, side}, ranges);
    CHECK(std::all_of(maps.depth.begin(), maps.depth.end(), [](float z) { return std::isnan(z) || z > 0; }));
    return toile_failures();
}
