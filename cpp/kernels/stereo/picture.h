// One level of a picture's pyramid, packed for reading eight places at a time.
#pragma once
#include <immintrin.h>

#include <cstdint>
#include <vector>

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
    bool person(int x, int y) const { return inside(x, y) && mask[index(x, y)]; }
    std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }

    struct Slopes {
        __m256 value, dx, dy;
    };
    /// Bilinear values and derivatives at eight places, pixel (0,0) at (0,0); the border's values go on beyond it.
    Slopes read(__m256 x, __m256 y) const {
        const __m256 zero = _mm256_setzero_ps();
        x = _mm256_min_ps(_mm256_max_ps(x, zero), _mm256_set1_ps(static_cast<float>(width) - 1.001F));
        y = _mm256_min_ps(_mm256_max_ps(y, zero), _mm256_set1_ps(static_cast<float>(height) - 1.001F));
        const __m256i j = _mm256_cvttps_epi32(x), i = _mm256_cvttps_epi32(y);
        const __m256 fx = _mm256_sub_ps(x, _mm256_cvtepi32_ps(j)), fy = _mm256_sub_ps(y, _mm256_cvtepi32_ps(i));
        const __m256i at = _mm256_add_epi32(_mm256_mullo_epi32(i, _mm256_set1_epi32(width)), j);
        const int* words = reinterpret_cast<const int*>(words_.data());
        const __m256i upper = _mm256_i32gather_epi32(words, at, 4);
        const __m256i lower = _mm256_i32gather_epi32(words + width, at, 4);
        const __m256i low = _mm256_set1_epi32(0xffff);
        const __m256 a = _mm256_cvtepi32_ps(_mm256_and_si256(upper, low));
        const __m256 b = _mm256_cvtepi32_ps(_mm256_srli_epi32(upper, 16));
        const __m256 c = _mm256_cvtepi32_ps(_mm256_and_si256(lower, low));
        const __m256 d = _mm256_cvtepi32_ps(_mm256_srli_epi32(lower, 16));
        const __m256 top = _mm256_fmadd_ps(fx, _mm256_sub_ps(b, a), a);
        const __m256 bottom = _mm256_fmadd_ps(fx, _mm256_sub_ps(d, c), c);
        const __m256 scale = _mm256_set1_ps(STEP), dy = _mm256_sub_ps(bottom, top);
        const __m256 left = _mm256_sub_ps(b, a);
        const __m256 dx = _mm256_fmadd_ps(fy, _mm256_sub_ps(_mm256_sub_ps(d, c), left), left);
        return {_mm256_mul_ps(scale, _mm256_fmadd_ps(fy, dy, top)), _mm256_mul_ps(scale, dx), _mm256_mul_ps(scale, dy)};
    }

private:
    static constexpr float STEP = 1.0F / 256;
    std::vector<std::uint32_t> words_;
};

}  // namespace toile::stereo
