#include "kernels/stereo/search.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/parallel.h"

namespace toile::stereo {

namespace {

constexpr int STARTS = 6;            // random planes a pixel
constexpr float START_SLOPE = 0.3F;  // disparity a pixel
constexpr float LIKE = 0.03F;        // planes whose disparities differ by less [px] are one
constexpr float FARTHEST = 2;        // cost of a picture that does not show the window
constexpr double DAMPING = 1e-3;
constexpr int ARM = 3;             // a bend is that of 5 x 5 pixels, so far apart
constexpr float SAME_SURFACE = 1;  // depths that leave the plane by more [px] count less
constexpr double STRAIGHT = 0.1;   // weight of no bend, of 25
constexpr float LONGEST = 1;       // Gauss-Newton step [px]

/// Random numbers by counter (splitmix64): the same for a key, whoever asks first.
class Dice {
public:
    explicit Dice(std::uint64_t key) : state_(key) {}
    /// Uniform in [-1, 1).
    float roll() {
        state_ += 0x9e3779b97f4a7c15ULL;
        std::uint64_t z = state_;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
        return static_cast<float>((z ^ (z >> 31)) >> 40) * 0x1p-23F - 1;
    }

private:
    std::uint64_t state_;
};

Dice dice(std::uint64_t key, int pixel) {
    return Dice(key * 0xd1342543de82ef95ULL + static_cast<std::uint64_t>(pixel));
}

/// Calls f(pixel) for all pixels of a colour.
template <class Function>
void each(const std::vector<int>& pixels, Function&& f) {
    parallel_for(static_cast<std::int64_t>(pixels.size()), [&](std::int64_t k) { f(pixels[k]); }, 128);
}

}  // namespace

Search::Search(const std::vector<View>& views, const std::vector<Field>& fields, std::size_t own, float spacing,
               bool geometric, const StereoOptions& options)
    : views_(views), fields_(fields), view_(views[own]), own_(fields[own]), grid_(spacing), geometric_(geometric),
      options_(options), noise2_(static_cast<float>(options.noise * options.noise)) {}

Window Search::window(int x, int y) const {
    const Bend bend = own_.bends.empty() ? Bend{} : own_.bends[own_.slots[view_.picture.index(x, y)]];
    return Window(view_.picture, grid_, x, y, static_cast<float>(options_.colour), bend);
}

float Search::scale(int x, int y, const Plane& plane) const {
    float most = 0;
    for (const Pair& pair : view_.pairs) {
        const Warp warp(pair, static_cast<float>(x), static_cast<float>(y), plane);
        if (warp.q[2] > 0) most = std::max(most, disparity(pair, warp));
    }
    return most;
}

float Search::disagreement(const Pair& pair, const Warp& warp, float w) const {
    constexpr float none = std::numeric_limits<float>::infinity();
    const Picture& picture = views_[pair.view].picture;
    const std::int64_t pixel = warp.q[2] > 0 ? picture.nearest(warp.u, warp.v) : -1;
    const Field& field = fields_[pair.view];
    const int slot = pixel < 0 ? -1 : field.slots[pixel];
    if (slot < 0) return none;
    const auto x = static_cast<int>(pixel % picture.width), y = static_cast<int>(pixel / picture.width);
    const Plane& there = field.planes[slot];
    const float turned = warp.q[2] - pair.b[2] * w;  // d(1/z there) / dw = turned / q2^2
    if (!(there.w > 0) || !(turned > 0)) return none;
    const float own = w / warp.q[2];
    const float other = there.moved(warp.u - static_cast<float>(x), warp.v - static_cast<float>(y)).w;
    return std::abs(own - other) * warp.q[2] * warp.q[2] / turned * disparity(pair, warp);
}

Opinion Search::opinion(const Window& window, int x, int y, const Plane& plane) const {
    std::array<float, 16> cost, colour;
    Opinion out{};
    const int count = static_cast<int>(view_.pairs.size());
    for (int k = 0; k < count; ++k) {
        const Pair& pair = view_.pairs[k];
        const Picture& other = views_[pair.view].picture;
        const Warp warp(pair, static_cast<float>(x), static_cast<float>(y), plane);
        const bool shown = warp.q[2] > 0 && other.person(warp.u, warp.v);
        colour[k] = shown ? 1 - correlation(window, grid_, warp, pair, other, noise2_) : FARTHEST;
        cost[k] = colour[k];
        if (geometric_) {
            const auto most = static_cast<float>(options_.contradiction);
            cost[k] += static_cast<float>(options_.consistency) *
                       (shown ? std::min(disagreement(pair, warp, plane.w), most) / most : 1);
        }
        int at = k;
        for (; at > 0 && cost[out.order[at - 1]] > cost[k]; --at) out.order[at] = out.order[at - 1];
        out.order[at] = k;
    }
    out.counted = std::min(options_.best, count);
    for (int k = 0; k < out.counted; ++k) {
        out.cost += cost[out.order[k]] / static_cast<float>(out.counted);
        out.colour += colour[out.order[k]] / static_cast<float>(out.counted);
    }
    return out;
}

void Search::start(Field& field, std::uint64_t key) const {
    for (const auto& pixels : field.pixels)
        each(pixels, [&](int pixel) {
            const int x = pixel % view_.picture.width, y = pixel / view_.picture.width;
            const Window window = this->window(x, y);
            const Bounds& bound = field.bound(x, y);
            Dice random = dice(key, pixel);
            Cell& cell = field.cells[field.slots[pixel]];
            cell.cost = std::numeric_limits<float>::infinity();
            for (int k = 0; k < STARTS; ++k) {
                Plane plane{bound.low + (bound.high - bound.low) * 0.5F * (random.roll() + 1), 0, 0};
                const float slope = START_SLOPE / std::max(scale(x, y, plane), 1e-12F);
                plane.wx = slope * random.roll();
                plane.wy = slope * random.roll();
                const float cost = opinion(window, x, y, plane).cost;
                if (cost < cell.cost) cell = {plane, cost};
            }
        });
}

void Search::weigh(Field& field) const {
    for (const auto& pixels : field.pixels)
        each(pixels, [&](int pixel) {
            const int x = pixel % view_.picture.width, y = pixel / view_.picture.width;
            Cell& cell = field.cells[field.slots[pixel]];
            cell.cost = opinion(window(x, y), x, y, cell.plane).cost;
        });
}

void Search::sweep(Field& field, float reach, std::uint64_t key) const {
    for (std::size_t colour = 0; colour < 2; ++colour)
        each(field.pixels[colour], [&](int pixel) { visit(field, pixel, reach, 2 * key + colour); });
}

void Search::visit(Field& field, int pixel, float reach, std::uint64_t key) const {
    const int width = view_.picture.width, x = pixel % width, y = pixel / width;
    const Bounds& bound = field.bound(x, y);
    const Window window = this->window(x, y);
    Cell cell = field.cells[field.slots[pixel]];
    const float pixels = std::max(scale(x, y, cell.plane), 1e-12F);
    const auto attempt = [&](const Plane& plane) {
        if (!(plane.w >= bound.low && plane.w <= bound.high)) return;
        const float apart = std::abs(plane.w - cell.plane.w) +
                            grid_.radius * (std::abs(plane.wx - cell.plane.wx) + std::abs(plane.wy - cell.plane.wy));
        if (apart * pixels < LIKE) return;
        const float cost = opinion(window, x, y, plane).cost;
        if (cost < cell.cost) cell = {plane, cost};
    };
    constexpr std::array<std::array<int, 2>, 4> sides{{{1, 0}, {-1, 0}, {0, 1}, {0, -1}}};
    for (const auto& side : sides) {
        int best = -1, steps = 0;
        for (int k = 1; k <= 5; k += 2) {  // odd, so of the other colour
            const int nx = x + k * side[0], ny = y + k * side[1];
            if (!view_.picture.inside(nx, ny)) break;
            const int n = field.slots[ny * width + nx];
            if (n >= 0 && field.cells[n].plane.w > 0 && (best < 0 || field.cells[n].cost < field.cells[best].cost))
                best = n, steps = k;
        }
        if (best >= 0)
            attempt(field.cells[best].plane.moved(static_cast<float>(-steps * side[0]),
                                                  static_cast<float>(-steps * side[1])));
    }
    Dice random = dice(key, pixel);
    const float far = reach / pixels, tilt = reach / (pixels * grid_.radius);
    const float a = random.roll(), b = random.roll(), c = random.roll();
    attempt({cell.plane.w + far * a, cell.plane.wx, cell.plane.wy});
    attempt({cell.plane.w, cell.plane.wx + tilt * b, cell.plane.wy + tilt * c});
    const float d = random.roll(), e = random.roll(), f = random.roll();
    attempt({cell.plane.w + 0.3F * far * d, cell.plane.wx + 0.3F * tilt * e, cell.plane.wy + 0.3F * tilt * f});
    field.cells[field.slots[pixel]] = cell;
}

void Search::bend(Field& field) const {
    using Terms = Eigen::Matrix<double, 6, 1>;
    std::vector<Bend> bends(field.cells.size());
    const auto fit = [&](int pixel) {
        const int width = view_.picture.width, x = pixel % width, y = pixel / width;
        const int slot = field.slots[pixel];
        const Plane& plane = field.cells[slot].plane;
        const float pixels = std::max(scale(x, y, plane), 1e-12F);
        Eigen::Matrix<double, 6, 6> H = Eigen::Matrix<double, 6, 6>::Zero();
        Terms right = Terms::Zero();
        for (int i = -2; i <= 2; ++i)
            for (int j = -2; j <= 2; ++j) {
                const int nx = x + ARM * j, ny = y + ARM * i;
                if (!view_.picture.inside(nx, ny)) continue;
                const int there = field.slots[view_.picture.index(nx, ny)];
                const float w = there < 0 ? 0 : field.cells[there].plane.w;
                if (!(w > 0)) continue;
                const float beyond = w - plane.moved(static_cast<float>(ARM * j), static_cast<float>(ARM * i)).w;
                const double r = beyond * pixels, weight = 1 / std::pow(1 + std::pow(r / SAME_SURFACE, 2), 2);
                Terms term;
                term << 1, j, i, 0.5 * j * j, j * i, 0.5 * i * i;
                H += weight * term * term.transpose();
                right += weight * r * term;
            }
        H.diagonal().array() += 1e-6;
        H.diagonal().tail<3>().array() += STRAIGHT;
        const Terms found = H.ldlt().solve(right) / (ARM * ARM * pixels);
        if (found.allFinite())
            bends[slot] = {static_cast<float>(found[3]), static_cast<float>(found[4]), static_cast<float>(found[5])};
    };
    for (const auto& pixels : field.pixels) each(pixels, fit);
    field.bends = std::move(bends);
}

void Search::refine(Field& field, int steps) const {
    const auto improve = [&](int pixel) {
        const int x = pixel % view_.picture.width, y = pixel / view_.picture.width;
        const Window window = this->window(x, y);  // bent as the surface is
        Cell& cell = field.cells[field.slots[pixel]];
        Opinion now = opinion(window, x, y, cell.plane);
        for (int k = 0; k < steps; ++k) {
            std::array<double, 6> h{};
            std::array<double, 3> g{};
            for (int i = 0; i < now.counted; ++i) {
                const Pair& pair = view_.pairs[now.order[i]];
                const Picture& other = views_[pair.view].picture;
                const Warp warp(pair, static_cast<float>(x), static_cast<float>(y), cell.plane);
                if (warp.sound(other, grid_.radius))
                    add_normal_equations(window, grid_, warp, pair, other, noise2_, h, g);
            }
            Mat3 H;
            H << h[0], h[1], h[2], h[1], h[3], h[4], h[2], h[4], h[5];
            const Vec3 unit = H.diagonal().cwiseSqrt().cwiseInverse();
            if (!unit.allFinite()) return;
            Mat3 scaled = unit.asDiagonal() * H * unit.asDiagonal();  // unit diagonal, whatever the units
            scaled.diagonal().array() += DAMPING;
            const Vec3 step = unit.asDiagonal() * scaled.ldlt().solve(unit.asDiagonal() * Vec3(-g[0], -g[1], -g[2]));
            const Plane next{cell.plane.w + static_cast<float>(step[0]), cell.plane.wx + static_cast<float>(step[1]),
                             cell.plane.wy + static_cast<float>(step[2])};
            if (!(std::abs(static_cast<float>(step[0])) * scale(x, y, cell.plane) < LONGEST && next.w > 0)) return;
            const Opinion then = opinion(window, x, y, next);
            if (!(then.cost < now.cost)) return;
            cell = {next, then.cost};
            now = then;
        }
    };
    for (const auto& pixels : field.pixels) each(pixels, improve);
}

}  // namespace toile::stereo
