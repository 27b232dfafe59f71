// One level of a picture's pyramid, packed for reading eight places at a time.
#pragma once
#include <cmath>
#include <cstdint>
#include <vector>

#include "kernels/stereo/lanes.h"

namespace toile::stereo {

/// Grey values in steps of 1/256; a word holds a pixel (lower half) and its right neighbour, so that two words give
/// all that a bilinear value needs.
class Picture {
public:
    Picture(int height, int width, const std::vector<float>& grey, std::vector<std::uint8_t> mask);

    int height, width;
    std::vector<std::uint8_t> mask;

    float at(int x, int y) const { return static_cast<float>(words_[index(x, y)] & 0xffff) * STEP; }
    bool inside(int x, int y) const { return x >= 0 && y >= 0 && x < width && y < height; }
    std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
    /// The pixel nearest to a place, pixel (0,0) at (0,0); -1 where the picture has none, or the place is no number.
    std::int64_t nearest(float u, float v) const {
        const float x = std::floor(u + 0.5F), y = std::floor(v + 0.5F);
        const bool shown = x >= 0 && y >= 0 && x < static_cast<float>(width) && y < static_cast<float>(height);
        return shown ? static_cast<std::int64_t>(index(static_cast<int>(x), static_cast<int>(y))) : -1;
    }
    bool person(float u, float v) const {
        const std::int64_t at = nearest(u, v);
        return at >= 0 && mask[at];
    }

    struct Slopes {
        Floats value, dx, dy;
    };
    /// Bilinear values and derivatives at eight places, pixel (0,0) at (0,0); the border's values go on beyond it.
    Slopes read(Floats x, Floats y) const {
        x = clamped(x, static_cast<float>(width) - 1.001F);
        y = clamped(y, static_cast<float>(height) - 1.001F);
        const Ints j = truncated(x), i = truncated(y), at = i * width + j;
        const Floats fx = x - as_floats(j), fy = y - as_floats(i);
        const Words upper = gather(words_.data(), at), lower = gather(words_.data() + width, at);
        const Floats a = as_floats(upper & 0xffff), b = as_floats(upper >> 16);
        const Floats c = as_floats(lower & 0xffff), d = as_floats(lower >> 16);
        const Floats top = fma(fx, b - a, a), bottom = fma(fx, d - c, c), dy = bottom - top;
        return {STEP * fma(fy, dy, top), STEP * fma(fy, (d - c) - (b - a), b - a), STEP * dy};
    }

private:
    static constexpr float STEP = 1.0F / 256;
    std::vector<std::uint32_t> words_;
};

}  // namespace toile::stereo
