#include "kernels/stereo/picture.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace toile::stereo {

Picture::Picture(int height_, int width_, const std::vector<float>& grey, std::vector<std::uint8_t> mask_)
    : height(height_), width(width_), mask(std::move(mask_)), words_(grey.size()) {
    const auto step = [&](int x, int y) {
        const float value = std::clamp(grey[index(std::min(x, width - 1), y)], 0.0F, 255.0F);
        return static_cast<std::uint32_t>(std::lround(value / STEP));
    };
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) words_[index(x, y)] = step(x, y) | step(x + 1, y) << 16;
}

}  // namespace toile::stereo
