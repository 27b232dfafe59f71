#include "kernels/occlusion.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <numbers>

#include "base/errors.h"
#include "base/parallel.h"
#include "geometry/closest.h"
#include "geometry/laplacian.h"

namespace toile {

namespace {

constexpr int MOST_RAYS = 65536;
constexpr std::int64_t GRAIN = 64;  // vertices

void check(const Vertices& V, const Faces& F, const OcclusionOptions& o) {
    check_mesh("occlusion", V, F);
    if (o.rays < 1 || o.rays > MOST_RAYS)
        throw InputError("occlusion: rays is " + std::to_string(o.rays) + ", expected 1 to " +
                         std::to_string(MOST_RAYS));
    if (!(o.relative_offset > 0 && o.relative_offset <= 1))
        throw InputError("occlusion: relative_offset is " + std::to_string(o.relative_offset) +
                         ", expected above 0 and at most 1");
    if (!(o.reach > 0 && std::isfinite(o.reach))) throw InputError("occlusion: reach is not positive and finite");
}

/// Bits of an index in reverse, as a fraction of one (van der Corput).
double radical_inverse(std::uint32_t i) {
    i = (i << 16) | (i >> 16);
    i = ((i & 0x00ff00ffu) << 8) | ((i & 0xff00ff00u) >> 8);
    i = ((i & 0x0f0f0f0fu) << 4) | ((i & 0xf0f0f0f0u) >> 4);
    i = ((i & 0x33333333u) << 2) | ((i & 0xccccccccu) >> 2);
    i = ((i & 0x55555555u) << 1) | ((i & 0xaaaaaaaau) >> 1);
    return i * 0x1p-32;
}

/// 0..1 from seed and vertex (splitmix64, Steele et al. 2014).
double draw(std::uint64_t seed, std::uint64_t vertex) {
    std::uint64_t z = seed * 0xd1342543de82ef95u + (vertex + 1) * 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

/// Cosine-weighted directions about +z: points spread evenly over the disk, lifted (Malley). In the order of their angle,
/// so that neighbours make coherent packets.
std::vector<std::array<double, 3>> fan(int rays) {
    std::vector<std::array<double, 3>> out(static_cast<std::size_t>(rays));
    for (int i = 0; i < rays; ++i) {
        const double squared = radical_inverse(static_cast<std::uint32_t>(i)) + 0.5 / rays;
        const double angle = 2 * std::numbers::pi * (i + 0.5) / rays, r = std::sqrt(std::min(squared, 1.0));
        out[static_cast<std::size_t>(i)] = {r * std::cos(angle), r * std::sin(angle),
                                            std::sqrt(std::max(0.0, 1 - squared))};
    }
    return out;
}

/// Two unit vectors that make a right-handed frame with unit n (Duff et al. 2017).
void tangents(const Vec3& n, Vec3& a, Vec3& b) {
    const double sign = std::copysign(1.0, n[2]), s = -1 / (sign + n[2]), t = n[0] * n[1] * s;
    a = Vec3(1 + sign * n[0] * n[0] * s, sign * t, -sign * n[0]);
    b = Vec3(t, sign + n[1] * n[1] * s, -n[1]);
}

}  // namespace

Vector ambient_occlusion(const Vertices& V, const Faces& F, const OcclusionOptions& o, const Indices& of) {
    check(V, F, o);
    check_indices("occlusion", "of", of, V.rows());
    const SurfaceIndex index(V, F);
    const Vertices N = vertex_normals(V, F);
    const auto directions = fan(o.rays);
    const double offset = o.relative_offset * index.diagonal();
    Vector open = Vector::Ones(of.size() > 0 ? of.size() : V.rows());
    parallel_for(open.size(), [&](std::int64_t i) {
        const std::int64_t v = of.size() > 0 ? of[i] : i;
        const Vec3 n = N.row(v);
        if (n.squaredNorm() == 0) return;
        Vec3 a, b;
        tangents(n, a, b);
        const double turn = 2 * std::numbers::pi * draw(o.seed, static_cast<std::uint64_t>(v));
        const Vec3 x = std::cos(turn) * a + std::sin(turn) * b, y = n.cross(x), origin = Vec3(V.row(v)) + offset * n;
        int shaded = 0;
        std::array<Vec3, SurfaceIndex::packet> rays;
        for (int first = 0; first < o.rays; first += SurfaceIndex::packet) {
            const int count = std::min(SurfaceIndex::packet, o.rays - first);
            for (int k = 0; k < count; ++k) {
                const auto& d = directions[static_cast<std::size_t>(first + k)];
                rays[static_cast<std::size_t>(k)] = d[0] * x + d[1] * y + d[2] * n;
            }
            shaded += index.occluded_of(origin, rays.data(), count, o.reach);
        }
        open[i] = 1 - static_cast<double>(shaded) / o.rays;
    }, GRAIN);
    return open;
}

}  // namespace toile
