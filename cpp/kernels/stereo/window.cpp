#include "kernels/stereo/window.h"

#include <algorithm>

namespace toile::stereo {

namespace {

struct Places {
    __m256 u, v, z;
};

Places places(const Warp& warp, const Pair& pair, __m256 dx, __m256 dy, __m256 bend) {
    const auto at = [&](int k) {
        const __m256 plane = _mm256_fmadd_ps(
            _mm256_set1_ps(warp.hy[k]), dy, _mm256_fmadd_ps(_mm256_set1_ps(warp.hx[k]), dx, _mm256_set1_ps(warp.q[k])));
        return _mm256_fmadd_ps(_mm256_set1_ps(pair.b[k]), bend, plane);
    };
    const __m256 z = at(2);
    return {_mm256_div_ps(at(0), z), _mm256_div_ps(at(1), z), z};
}

float pivot(const Picture& picture, const Warp& warp) {
    return picture.at(static_cast<int>(warp.u), static_cast<int>(warp.v));
}

}  // namespace

Window::Window(const Picture& picture, const Grid& grid, int x, int y, float colour, const Bend& surface) {
    alignas(32) std::array<float, 8 * LANES> px, py, masked;
    for (std::size_t k = 0; k < LANES; ++k) {
        _mm256_store_ps(px.data() + 8 * k, grid.x[k]);
        _mm256_store_ps(py.data() + 8 * k, grid.y[k]);
    }
    const auto cx = static_cast<float>(x), cy = static_cast<float>(y), centre = picture.at(x, y);
    for (std::size_t n = 0; n < px.size(); ++n) {
        px[n] += cx;
        py[n] += cy;
        masked[n] =
            picture.person(static_cast<int>(std::floor(px[n] + 0.5F)), static_cast<int>(std::floor(py[n] + 0.5F)));
    }
    __m256 total = _mm256_setzero_ps(), first = total, second = total;
    __m256 value[LANES];
    const __m256 one = _mm256_set1_ps(1), scale = _mm256_set1_ps(1 / colour), middle = _mm256_set1_ps(centre);
    for (std::size_t k = 0; k < LANES; ++k) {
        value[k] = _mm256_sub_ps(
            picture.read(_mm256_load_ps(px.data() + 8 * k), _mm256_load_ps(py.data() + 8 * k)).value, middle);
        const __m256 apart = _mm256_mul_ps(value[k], scale);
        weight[k] = _mm256_div_ps(_mm256_load_ps(masked.data() + 8 * k), _mm256_fmadd_ps(apart, apart, one));
        total = _mm256_add_ps(total, weight[k]);
        first = _mm256_fmadd_ps(weight[k], value[k], first);
    }
    const float all = std::max(sum(total), 1e-6F), shift = sum(first) / all;
    const __m256 inverse = _mm256_set1_ps(1 / all), shifted = _mm256_set1_ps(shift);
    for (std::size_t k = 0; k < LANES; ++k) {
        const __m256 apart = _mm256_sub_ps(value[k], shifted);
        weight[k] = _mm256_mul_ps(weight[k], inverse);
        deviation[k] = _mm256_mul_ps(weight[k], apart);
        second = _mm256_fmadd_ps(deviation[k], apart, second);
    }
    const __m256 xx = _mm256_set1_ps(0.5F * surface.xx), xy = _mm256_set1_ps(surface.xy);
    const __m256 yy = _mm256_set1_ps(0.5F * surface.yy);
    for (std::size_t k = 0; k < LANES; ++k) {
        const __m256 along = _mm256_fmadd_ps(xx, grid.x[k], _mm256_mul_ps(xy, grid.y[k]));
        bend[k] = _mm256_fmadd_ps(along, grid.x[k], _mm256_mul_ps(yy, _mm256_mul_ps(grid.y[k], grid.y[k])));
    }
    mean = centre + shift;
    variance = sum(second);
}

float correlation(const Window& window, const Grid& grid, const Warp& warp, const Pair& pair, const Picture& picture,
                  float noise2) {
    if (!warp.sound(picture, grid.radius)) return -1;
    const __m256 middle = _mm256_set1_ps(pivot(picture, warp));
    __m256 s1 = _mm256_setzero_ps(), s2 = s1, cross = s1;
    for (std::size_t k = 0; k < LANES; ++k) {
        const Places at = places(warp, pair, grid.x[k], grid.y[k], window.bend[k]);
        const __m256 s = _mm256_sub_ps(picture.read(at.u, at.v).value, middle);
        const __m256 ws = _mm256_mul_ps(window.weight[k], s);
        s1 = _mm256_add_ps(s1, ws);
        s2 = _mm256_fmadd_ps(ws, s, s2);
        cross = _mm256_fmadd_ps(window.deviation[k], s, cross);
    }
    const float mean = sum(s1), variance = std::max(sum(s2) - mean * mean, 0.0F);
    return sum(cross) / std::sqrt((window.variance + noise2) * (variance + noise2));
}

void add_normal_equations(const Window& window, const Grid& grid, const Warp& warp, const Pair& pair,
                          const Picture& picture, float noise2, std::array<double, 6>& H, std::array<double, 3>& g) {
    const __m256 zero = _mm256_setzero_ps(), middle = _mm256_set1_ps(pivot(picture, warp));
    __m256 J1[3]{zero, zero, zero}, Jr[3]{zero, zero, zero}, Js[3]{zero, zero, zero};
    __m256 JJ[6]{zero, zero, zero, zero, zero, zero};
    __m256 s1 = zero, s2 = zero, cross = zero;
    for (std::size_t k = 0; k < LANES; ++k) {
        const Places at = places(warp, pair, grid.x[k], grid.y[k], window.bend[k]);
        const auto read = picture.read(at.u, at.v);
        const __m256 s = _mm256_sub_ps(read.value, middle), w = window.weight[k], ws = _mm256_mul_ps(w, s);
        s1 = _mm256_add_ps(s1, ws);
        s2 = _mm256_fmadd_ps(ws, s, s2);
        cross = _mm256_fmadd_ps(window.deviation[k], s, cross);
        const __m256 b2 = _mm256_set1_ps(pair.b[2]);
        const __m256 du = _mm256_fnmadd_ps(at.u, b2, _mm256_set1_ps(pair.b[0]));
        const __m256 dv = _mm256_fnmadd_ps(at.v, b2, _mm256_set1_ps(pair.b[1]));
        const __m256 slope = _mm256_div_ps(_mm256_fmadd_ps(read.dx, du, _mm256_mul_ps(read.dy, dv)), at.z);
        const __m256 J[3]{slope, _mm256_mul_ps(slope, grid.x[k]), _mm256_mul_ps(slope, grid.y[k])};
        for (std::size_t a = 0, n = 0; a < 3; ++a) {
            const __m256 wJ = _mm256_mul_ps(w, J[a]);
            J1[a] = _mm256_add_ps(J1[a], wJ);
            Jr[a] = _mm256_fmadd_ps(window.deviation[k], J[a], Jr[a]);
            Js[a] = _mm256_fmadd_ps(wJ, s, Js[a]);
            for (std::size_t b = a; b < 3; ++b, ++n) JJ[n] = _mm256_fmadd_ps(wJ, J[b], JJ[n]);
        }
    }
    const double mean = sum(s1), variance = std::max(sum(s2) - mean * mean, 0.0), covariance = sum(cross);
    const double own = window.variance + noise2, gain = covariance / own;
    const double weight = 1 / (std::max(variance - gain * covariance, 0.0) + noise2);
    std::array<double, 3> first, with_r;
    for (std::size_t a = 0; a < 3; ++a) {
        first[a] = sum(J1[a]);
        with_r[a] = sum(Jr[a]);
        g[a] += weight * (sum(Js[a]) - first[a] * mean - gain * with_r[a]);
    }
    for (std::size_t a = 0, n = 0; a < 3; ++a)
        for (std::size_t b = a; b < 3; ++b, ++n)
            H[n] += weight * (sum(JJ[n]) - first[a] * first[b] - with_r[a] * with_r[b] / own);
}

}  // namespace toile::stereo
