#include "kernels/raster.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

namespace {

constexpr int SUBPIXEL_BITS = 12;
constexpr std::int64_t SUBPIXEL = std::int64_t{1} << SUBPIXEL_BITS;  // units a pixel
constexpr double GUARD = 131072;  // [px]; snapped corners stay under 2^29, so edge functions fit 64 bits
constexpr int LARGEST_SIDE = 32768;
constexpr int TILE = 32;  // pixels
constexpr std::int64_t FACE_BLOCK = 1024;

struct Corner {
    std::int32_t x, y;  // image position in units of 1/4096 px
};

/// z = numerator / (plane . (u, v, 1)) on the plane of a face, kept between the depths of its corners.
struct DepthPlane {
    Vec3 plane;
    double numerator, nearest, farthest;

    double at(double u, double v) const {
        const double z = numerator / (plane[0] * u + (plane[1] * v + plane[2]));
        if (!(z >= nearest)) return nearest;  // an edge-on plane divides by zero
        return std::min(z, farthest);
    }
};

/// A face, or a piece of a clipped one, that covers at least one pixel centre's row and column.
struct Triangle {
    std::array<Corner, 3> corner;           // turning from x to y: positive area
    std::int16_t left, right, top, bottom;  // pixels, inclusive, within the image
    std::int32_t face;
};

struct Camera {
    Mat3 K, inverse;
    int height, width;
    double near_plane;
    std::array<Vec3, 5> inside;  // half-spaces n . p >= offset that clipping keeps: near plane, guard band
    std::array<double, 5> offset;

    Camera(const Mat3& K_, int height_, int width_, double near_)
        : K(K_), inverse(K_.inverse()), height(height_), width(width_), near_plane(near_), offset{near_, 0, 0, 0, 0} {
        const Vec3 u = K.row(0), v = K.row(1), z(0, 0, 1);
        inside = {z, GUARD * z + u, GUARD * z - u, GUARD * z + v, GUARD * z - v};
    }
    bool keeps(const Vec3& p) const {
        for (std::size_t k = 0; k < 5; ++k)
            if (!(inside[k].dot(p) >= offset[k])) return false;
        return true;
    }
    Corner project(const Vec3& p) const {
        const double u = K.row(0).dot(p) / p[2], v = K.row(1).dot(p) / p[2];
        const auto snap = [](double x) { return static_cast<std::int32_t>(std::floor(x * SUBPIXEL + 0.5)); };
        return {snap(std::clamp(u, -GUARD, GUARD)), snap(std::clamp(v, -GUARD, GUARD))};
    }
};

void check_camera(const Mat3& K, int height, int width, const RasterOptions& options) {
    check_finite("raster", "K", K);
    require(K(0, 0) > 0 && K(1, 1) > 0, "raster: K has focal lengths " + std::to_string(K(0, 0)) + " and " +
                                            std::to_string(K(1, 1)) + ", expected positive ones");
    require(K(1, 0) == 0, "raster: K[1, 0] is " + std::to_string(K(1, 0)) + ", expected 0");
    require(K.row(2) == Eigen::RowVector3d(0, 0, 1), "raster: K[2] is not (0, 0, 1)");
    require(height >= 1 && height <= LARGEST_SIDE && width >= 1 && width <= LARGEST_SIDE,
            "raster: size is (" + std::to_string(height) + ", " + std::to_string(width) + "), expected 1 to " +
                std::to_string(LARGEST_SIDE) + " a side");
    require(std::isfinite(options.near_plane) && options.near_plane > 0,
            "raster: near_plane is " + std::to_string(options.near_plane) + ", expected a positive distance");
}

/// What no pixel of the face lies before.
double nearest_depth(const Vertices& V, const Faces& F, Eigen::Index f, const Camera& camera) {
    return std::max(camera.near_plane, std::min({V(F(f, 0), 2), V(F(f, 1), 2), V(F(f, 2), 2)}));
}

/// The corners start at the lowest vertex index, so that copies of a face get the same bits however they are turned.
DepthPlane depth_plane(const Vertices& V, const Faces& F, Eigen::Index f, const Camera& camera) {
    int first = 0;
    for (int c = 1; c < 3; ++c)
        if (F(f, c) < F(f, first)) first = c;
    const Vec3 a = V.row(F(f, first)), b = V.row(F(f, (first + 1) % 3)), c = V.row(F(f, (first + 2) % 3));
    const Vec3 normal = (b - a).cross(c - a);
    return {camera.inverse.transpose() * normal, normal.dot(a),
            std::max(camera.near_plane, std::min({a[2], b[2], c[2]})), std::max({a[2], b[2], c[2]})};
}

/// First and last pixel whose centre lies in [low, high], cut to [0, size).
std::pair<int, int> pixel_range(std::int32_t low, std::int32_t high, int size) {
    constexpr std::int64_t half = SUBPIXEL / 2;
    const std::int64_t first = (low + half - 1) >> SUBPIXEL_BITS, last = (high - half) >> SUBPIXEL_BITS;
    return {static_cast<int>(std::max<std::int64_t>(first, 0)),
            static_cast<int>(std::min<std::int64_t>(last, size - 1))};
}

/// Twice the signed area of (a, b, p).
std::int64_t edge_function(const Corner& a, const Corner& b, std::int64_t px, std::int64_t py) {
    return (std::int64_t{b.x} - a.x) * (py - a.y) - (std::int64_t{b.y} - a.y) * (px - a.x);
}

/// Gives the image triangle (a, b, c), all of face f or a piece of it, unless it covers no pixel centre for certain.
template <class Give>
void give_triangle(Corner a, Corner b, Corner c, Eigen::Index f, const Camera& camera, Give&& give) {
    const auto [left, right] = pixel_range(std::min({a.x, b.x, c.x}), std::max({a.x, b.x, c.x}), camera.width);
    const auto [top, bottom] = pixel_range(std::min({a.y, b.y, c.y}), std::max({a.y, b.y, c.y}), camera.height);
    if (left > right || top > bottom) return;
    const std::int64_t area = edge_function(a, b, c.x, c.y);
    if (area == 0) return;
    if (area < 0) std::swap(b, c);
    const auto pixel = [](int i) { return static_cast<std::int16_t>(i); };
    give(Triangle{{a, b, c}, pixel(left), pixel(right), pixel(top), pixel(bottom), static_cast<std::int32_t>(f)});
}

/// Sutherland-Hodgman. Each cut runs from the kept end to the lost one, so the two faces of an edge get the same point.
template <class Give>
void give_clipped(const Vertices& V, const Faces& F, Eigen::Index f, const Camera& camera, Give&& give) {
    std::vector<Vec3> polygon{V.row(F(f, 0)), V.row(F(f, 1)), V.row(F(f, 2))}, next;
    for (std::size_t k = 0; k < camera.inside.size() && !polygon.empty(); ++k, polygon.swap(next)) {
        next.clear();
        const auto height = [&](const Vec3& p) { return camera.inside[k].dot(p) - camera.offset[k]; };
        for (std::size_t i = 0; i < polygon.size(); ++i) {
            const Vec3 &p = polygon[i], &q = polygon[(i + 1) % polygon.size()];
            const double hp = height(p), hq = height(q);
            if (hp >= 0) next.push_back(p);
            if (hp >= 0 && hq < 0) next.push_back(p + (q - p) * (hp / (hp - hq)));
            if (hp < 0 && hq >= 0) next.push_back(q + (p - q) * (hq / (hq - hp)));
        }
        if (k == 0)
            for (Vec3& p : next) p[2] = std::max(p[2], camera.near_plane);
    }
    if (polygon.size() < 3) return;
    for (std::size_t i = 2; i < polygon.size(); ++i)
        give_triangle(camera.project(polygon[0]), camera.project(polygon[i - 1]), camera.project(polygon[i]), f, camera,
                      give);
}

/// A mesh and where its vertices lie in a picture.
class Projected {
public:
    Projected(const Vertices& V, const Faces& F, const Camera& camera)
        : V_(V), F_(F), camera_(camera), corner_(static_cast<std::size_t>(V.rows())), kept_(corner_.size()) {
        parallel_for(V.rows(), [&](std::int64_t v) {
            const Vec3 p = V.row(v);
            kept_[v] = camera.keeps(p);
            if (kept_[v]) corner_[v] = camera.project(p);
        }, 4096);
    }

    /// Gives the image triangles of faces [begin, end).
    template <class Give>
    void each_triangle(Eigen::Index begin, Eigen::Index end, Give&& give) const {
        for (Eigen::Index f = begin; f < end; ++f) {
            const int i = F_(f, 0), j = F_(f, 1), k = F_(f, 2);
            if (kept_[i] && kept_[j] && kept_[k])
                give_triangle(corner_[i], corner_[j], corner_[k], f, camera_, give);
            else
                give_clipped(V_, F_, f, camera_, give);
        }
    }

private:
    const Vertices& V_;
    const Faces& F_;
    const Camera& camera_;
    std::vector<Corner> corner_;
    std::vector<char> kept_;
};

std::vector<Triangle> visible_triangles(const Projected& mesh, Eigen::Index faces) {
    std::vector<std::vector<Triangle>> blocks(static_cast<std::size_t>((faces + FACE_BLOCK - 1) / FACE_BLOCK));
    parallel_for(static_cast<std::int64_t>(blocks.size()), [&](std::int64_t b) {
        mesh.each_triangle(b * FACE_BLOCK, std::min<Eigen::Index>(faces, (b + 1) * FACE_BLOCK),
                           [&](const Triangle& t) { blocks[b].push_back(t); });
    }, 1);
    std::size_t count = 0;
    for (const auto& block : blocks) count += block.size();
    std::vector<Triangle> all;
    all.reserve(count);
    for (const auto& block : blocks) all.insert(all.end(), block.begin(), block.end());
    return all;
}

/// Triangles of each tile in compressed rows.
struct TileLists {
    int across, down;
    std::vector<std::size_t> start;
    std::vector<std::uint32_t> triangle;

    TileLists(const std::vector<Triangle>& triangles, const Camera& camera)
        : across((camera.width + TILE - 1) / TILE), down((camera.height + TILE - 1) / TILE),
          start(static_cast<std::size_t>(across) * down + 1, 0) {
        const auto each_tile = [&](const Triangle& t, auto&& visit) {
            for (int y = t.top / TILE; y <= t.bottom / TILE; ++y)
                for (int x = t.left / TILE; x <= t.right / TILE; ++x) visit(static_cast<std::size_t>(y) * across + x);
        };
        for (const Triangle& t : triangles) each_tile(t, [&](std::size_t tile) { ++start[tile + 1]; });
        for (std::size_t k = 1; k < start.size(); ++k) start[k] += start[k - 1];
        triangle.resize(start.back());
        std::vector<std::size_t> place(start.begin(), start.end() - 1);
        for (std::size_t i = 0; i < triangles.size(); ++i)
            each_tile(triangles[i], [&](std::size_t tile) { triangle[place[tile]++] = static_cast<std::uint32_t>(i); });
    }
};

/// Draws one triangle of a face into the pixels [left, right] x [top, bottom]. Many cover no pixel centre: only of the others
/// the depth is asked for, and only of those that nothing nearer covers the plane.
void draw(const Triangle& t, const Vertices& V, const Faces& F, const Camera& camera, int left, int right, int top,
          int bottom, RasterResult& image) {
    std::optional<double> nearest;
    std::optional<DepthPlane> plane;
    std::array<std::int64_t, 3> row, step_x, step_y;  // edge functions, never negative inside
    for (std::size_t k = 0; k < 3; ++k) {
        const Corner &a = t.corner[k], &b = t.corner[(k + 1) % 3];
        const std::int64_t dx = std::int64_t{b.x} - a.x, dy = std::int64_t{b.y} - a.y;
        const bool top_left = dy < 0 || (dy == 0 && dx > 0);  // y points down: such an edge owns its points
        row[k] = edge_function(a, b, left * SUBPIXEL + SUBPIXEL / 2, top * SUBPIXEL + SUBPIXEL / 2) - !top_left;
        step_x[k] = -dy * SUBPIXEL;
        step_y[k] = dx * SUBPIXEL;
    }
    for (int i = top; i <= bottom; ++i) {
        auto e = row;
        std::int32_t* face = &image.face(i, 0);
        double* depth = &image.depth(i, 0);
        for (int j = left; j <= right; ++j) {
            if ((e[0] | e[1] | e[2]) >= 0) {
                if (!nearest) nearest = nearest_depth(V, F, t.face, camera);
                if (*nearest <= depth[j]) {
                    if (!plane) plane = depth_plane(V, F, t.face, camera);
                    const double z = plane->at(j + 0.5, i + 0.5);
                    if (z < depth[j] || (z == depth[j] && t.face < face[j])) {
                        depth[j] = z;
                        face[j] = t.face;
                    }
                }
            }
            for (std::size_t k = 0; k < 3; ++k) e[k] += step_x[k];
        }
        for (std::size_t k = 0; k < 3; ++k) row[k] += step_y[k];
    }
}

/// Draws in parallel, each tile of the picture by one thread.
void draw_by_tiles(const Projected& mesh, const Vertices& V, const Faces& F, const Camera& camera,
                   RasterResult& image) {
    const std::vector<Triangle> triangles = visible_triangles(mesh, F.rows());
    const TileLists tiles(triangles, camera);
    parallel_for(static_cast<std::int64_t>(tiles.across) * tiles.down, [&](std::int64_t tile) {
        const int x = static_cast<int>(tile % tiles.across) * TILE, y = static_cast<int>(tile / tiles.across) * TILE;
        for (std::size_t k = tiles.start[tile]; k < tiles.start[tile + 1]; ++k) {
            const Triangle& t = triangles[tiles.triangle[k]];
            draw(t, V, F, camera, std::max<int>(t.left, x), std::min<int>(t.right, x + TILE - 1),
                 std::max<int>(t.top, y), std::min<int>(t.bottom, y + TILE - 1), image);
        }
    }, 1);
}

/// Barycentrics of the point of depth z on the ray of pixel centre (u, v), cut to the face.
Eigen::RowVector3d barycentric_at(const Vertices& V, const Faces& F, std::int32_t f, const Camera& camera, double u,
                                  double v, double z) {
    const Vec3 p = z * (camera.inverse * Vec3(u, v, 1));
    const Vec3 a = V.row(F(f, 0)), b = V.row(F(f, 1)), c = V.row(F(f, 2)), normal = (b - a).cross(c - a);
    Eigen::RowVector3d weight(normal.dot((b - p).cross(c - p)), normal.dot((c - p).cross(a - p)),
                              normal.dot((a - p).cross(b - p)));
    weight = weight.cwiseMax(0);
    const double sum = weight.sum();
    return sum > 0 ? Eigen::RowVector3d(weight / sum) : Eigen::RowVector3d(1, 0, 0);
}

}  // namespace

RasterResult raster(const Vertices& V, const Faces& F, const Mat3& K, int height, int width,
                    const RasterOptions& options) {
    check_mesh("raster", V, F, "vertices_camera", "F");
    check_camera(K, height, width, options);
    const Camera camera(K, height, width, options.near_plane);
    const Projected mesh(V, F, camera);
    RasterResult image{FaceImage::Constant(height, width, -1),
                       Matrix::Constant(height, width, std::numeric_limits<double>::infinity()), Vertices(0, 3)};
    if (thread_count() == 1)  // in any order the same pixels: as the faces come
        mesh.each_triangle(0, F.rows(),
                           [&](const Triangle& t) { draw(t, V, F, camera, t.left, t.right, t.top, t.bottom, image); });
    else
        draw_by_tiles(mesh, V, F, camera, image);
    if (!options.barycentric) return image;
    image.barycentric = Vertices::Zero(static_cast<Eigen::Index>(height) * width, 3);
    parallel_for(height, [&](std::int64_t i) {
        for (int j = 0; j < width; ++j)
            if (image.face(i, j) >= 0)
                image.barycentric.row(i * width + j) =
                    barycentric_at(V, F, image.face(i, j), camera, j + 0.5, i + 0.5, image.depth(i, j));
    }, 16);
    return image;
}

}  // namespace toile
