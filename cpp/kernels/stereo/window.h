// A window of 32 samples about a pixel, and how well it correlates with another picture through a plane.
#pragma once
#include <array>
#include <cmath>

#include "kernels/stereo/picture.h"

namespace toile::stereo {

/// Inverse depth at a pixel's centre and its slopes, per pixel: 1/z is linear in the picture on every plane.
struct Plane {
    float w = 0, wx = 0, wy = 0;

    /// The same plane as the pixel (dx, dy) farther has it.
    Plane moved(float dx, float dy) const { return {w + wx * dx + wy * dy, wx, wy}; }
};

/// Second derivatives of the inverse depth, per pixel squared: what a plane lacks of a curved surface.
struct Bend {
    float xx = 0, xy = 0, yy = 0;
};

/// From a pixel (x, y) of inverse depth w to another camera: A (x, y, 1) + b w.
struct Pair {
    int view;
    std::array<std::array<float, 3>, 3> A;
    std::array<float, 3> b;
};

/// Where a window about a pixel falls in another picture: q(dx, dy) = q + hx dx + hy dy, projected.
struct Warp {
    std::array<float, 3> q, hx, hy;
    float u, v;  ///< of the centre

    Warp(const Pair& pair, float x, float y, const Plane& plane) {
        for (int k = 0; k < 3; ++k) {
            q[k] = pair.A[k][0] * x + pair.A[k][1] * y + pair.A[k][2] + pair.b[k] * plane.w;
            hx[k] = pair.A[k][0] + pair.b[k] * plane.wx;
            hy[k] = pair.A[k][1] + pair.b[k] * plane.wy;
        }
        u = q[0] / q[2];
        v = q[1] / q[2];
    }
    /// Before the camera with all the window, within the picture, the plane seen from the same side and not too aslant.
    bool sound(const Picture& picture, float radius) const {
        if (!(q[2] > 2 * radius * (std::abs(hx[2]) + std::abs(hy[2])))) return false;
        if (!(u >= 0 && v >= 0 && u <= static_cast<float>(picture.width - 1) &&
              v <= static_cast<float>(picture.height - 1)))
            return false;
        const float a = hx[0] - u * hx[2], b = hy[0] - u * hy[2], c = hx[1] - v * hx[2], d = hy[1] - v * hy[2];
        const float area = (a * d - b * c) / (q[2] * q[2]);  // of a pixel's picture
        return area > LEAST_AREA && area < 1 / LEAST_AREA;
    }
    static constexpr float LEAST_AREA = 0.08F;
};

/// Pixels that the picture of a point moves by, per inverse depth.
inline float disparity(const Pair& pair, const Warp& warp) {
    return std::hypot(pair.b[0] - warp.u * pair.b[2], pair.b[1] - warp.v * pair.b[2]) / warp.q[2];
}

constexpr int LANES = 4;  // of eight samples: a 6 x 6 grid without its corners

/// Where the samples lie [px].
struct Grid {
    Floats x[LANES]{}, y[LANES]{};
    float radius;

    explicit Grid(float spacing) : radius(2.5F * spacing) {
        std::size_t n = 0;
        for (int i = 0; i < 6; ++i)
            for (int j = 0; j < 6; ++j) {
                if ((i == 0 || i == 5) && (j == 0 || j == 5)) continue;
                x[n / 8][n % 8] = (static_cast<float>(j) - 2.5F) * spacing;
                y[n / 8][n % 8] = (static_cast<float>(i) - 2.5F) * spacing;
                ++n;
            }
    }
};

/// The samples of one pixel's window: weights of sum 1 by grey and mask, weighted deviations from the mean.
struct Window {
    Floats weight[LANES], deviation[LANES];
    Floats bend[LANES];  ///< inverse depth beyond the plane's
    float mean, variance;

    Window(const Picture& picture, const Grid& grid, int x, int y, float colour, const Bend& surface);
};

/// Weighted normalised correlation with `noise2` added to both variances; -1 where the warp is not sound.
float correlation(const Window& window, const Grid& grid, const Warp& warp, const Pair& pair, const Picture& picture,
                  float noise2);

/// Normal equations of (w, wx, wy) for one pair, gain and offset of the grey values eliminated; added to H (upper six,
/// row by row) and g.
void add_normal_equations(const Window& window, const Grid& grid, const Warp& warp, const Pair& pair,
                          const Picture& picture, float noise2, std::array<double, 6>& H, std::array<double, 3>& g);

}  // namespace toile::stereo
