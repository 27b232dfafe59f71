#include "kernels/stereo/window.h"

#include <algorithm>

namespace toile::stereo {

namespace {

struct Places {
    Floats u, v, z;
};

Places places(const Warp& warp, const Pair& pair, Floats dx, Floats dy, Floats bend) {
    const auto at = [&](int k) {
        const Floats plane = fma(all(warp.hy[k]), dy, fma(all(warp.hx[k]), dx, all(warp.q[k])));
        return fma(all(pair.b[k]), bend, plane);
    };
    const Floats z = at(2);
    return {at(0) / z, at(1) / z, z};
}

float pivot(const Picture& picture, const Warp& warp) {
    return picture.at(static_cast<int>(warp.u), static_cast<int>(warp.v));
}

}  // namespace

Window::Window(const Picture& picture, const Grid& grid, int x, int y, float colour, const Bend& surface) {
    const auto cx = static_cast<float>(x), cy = static_cast<float>(y), centre = picture.at(x, y);
    Floats total{}, first{}, second{}, value[LANES];
    for (std::size_t k = 0; k < LANES; ++k) {
        const Floats px = grid.x[k] + cx, py = grid.y[k] + cy;
        Floats masked;
        for (std::size_t n = 0; n < 8; ++n) masked[n] = picture.person(px[n], py[n]);
        value[k] = picture.read(px, py).value - centre;
        const Floats apart = value[k] * (1 / colour);
        weight[k] = masked / fma(apart, apart, all(1));
        total += weight[k];
        first = fma(weight[k], value[k], first);
    }
    const float weights = std::max(sum(total), 1e-6F), shift = sum(first) / weights;
    for (std::size_t k = 0; k < LANES; ++k) {
        const Floats apart = value[k] - shift;
        weight[k] *= 1 / weights;
        deviation[k] = weight[k] * apart;
        second = fma(deviation[k], apart, second);
    }
    for (std::size_t k = 0; k < LANES; ++k) {
        const Floats along = fma(all(0.5F * surface.xx), grid.x[k], surface.xy * grid.y[k]);
        bend[k] = fma(along, grid.x[k], 0.5F * surface.yy * (grid.y[k] * grid.y[k]));
    }
    mean = centre + shift;
    variance = sum(second);
}

float correlation(const Window& window, const Grid& grid, const Warp& warp, const Pair& pair, const Picture& picture,
                  float noise2) {
    if (!warp.sound(picture, grid.radius)) return -1;
    const float middle = pivot(picture, warp);
    Floats s1{}, s2{}, cross{};
    for (std::size_t k = 0; k < LANES; ++k) {
        const Places at = places(warp, pair, grid.x[k], grid.y[k], window.bend[k]);
        const Floats s = picture.read(at.u, at.v).value - middle, ws = window.weight[k] * s;
        s1 += ws;
        s2 = fma(ws, s, s2);
        cross = fma(window.deviation[k], s, cross);
    }
    const float mean = sum(s1), variance = std::max(sum(s2) - mean * mean, 0.0F);
    return sum(cross) / std::sqrt((window.variance + noise2) * (variance + noise2));
}

void add_normal_equations(const Window& window, const Grid& grid, const Warp& warp, const Pair& pair,
                          const Picture& picture, float noise2, std::array<double, 6>& H, std::array<double, 3>& g) {
    const float middle = pivot(picture, warp);
    Floats J1[3]{}, Jr[3]{}, Js[3]{}, JJ[6]{};
    Floats s1{}, s2{}, cross{};
    for (std::size_t k = 0; k < LANES; ++k) {
        const Places at = places(warp, pair, grid.x[k], grid.y[k], window.bend[k]);
        const auto read = picture.read(at.u, at.v);
        const Floats s = read.value - middle, w = window.weight[k], ws = w * s;
        s1 += ws;
        s2 = fma(ws, s, s2);
        cross = fma(window.deviation[k], s, cross);
        const Floats du = fma(at.u, all(-pair.b[2]), all(pair.b[0])), dv = fma(at.v, all(-pair.b[2]), all(pair.b[1]));
        const Floats slope = fma(read.dx, du, read.dy * dv) / at.z;
        const Floats J[3]{slope, slope * grid.x[k], slope * grid.y[k]};
        for (std::size_t a = 0, n = 0; a < 3; ++a) {
            const Floats wJ = w * J[a];
            J1[a] += wJ;
            Jr[a] = fma(window.deviation[k], J[a], Jr[a]);
            Js[a] = fma(wJ, s, Js[a]);
            for (std::size_t b = a; b < 3; ++b, ++n) JJ[n] = fma(wJ, J[b], JJ[n]);
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
