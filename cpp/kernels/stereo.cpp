#include "kernels/stereo.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "base/errors.h"
#include "base/parallel.h"
#include "kernels/stereo/rig.h"
#include "kernels/stereo/search.h"

namespace toile {

namespace {

using namespace stereo;

constexpr int MOST_SOURCES = 16;
constexpr int LARGEST_SIDE = 16384;
constexpr int LEAST_SIDE = 8;
constexpr float COARSE_SPACING = 0.75F;  // of the finest level's; there a pixel is larger
constexpr int STEPS = 2;                 // Gauss-Newton steps of a refinement
constexpr float WHITE = 250, BLACK = 4;
constexpr float PLAIN = 1.5F;  // deviations of noise: less contrast is none

void check_number(const char* name, double value, bool sound, const char* expected) {
    require(std::isfinite(value) && sound,
            std::string("stereo: ") + name + " is " + std::to_string(value) + ", expected " + expected);
}

void check_options(const StereoOptions& o) {
    check_number("sources", o.sources, o.sources >= 1 && o.sources <= MOST_SOURCES, "1 to 16");
    check_number("best", o.best, o.best >= 1, "at least 1");
    check_number("max_angle", o.max_angle, o.max_angle > 0, "a positive angle");
    check_number("coarsest", o.coarsest, o.coarsest >= 2 * LEAST_SIDE, "at least 16");
    check_number("start_iterations", o.start_iterations, o.start_iterations >= 0, "not negative");
    check_number("coarse_iterations", o.coarse_iterations, o.coarse_iterations >= 0, "not negative");
    check_number("iterations", o.iterations, o.iterations >= 0, "not negative");
    check_number("refinements", o.refinements, o.refinements >= 0, "not negative");
    check_number("spacing", o.spacing, o.spacing > 0 && o.spacing <= 64, "0 to 64");
    check_number("colour", o.colour, o.colour > 0, "positive");
    check_number("noise", o.noise, o.noise > 0, "positive");
    check_number("consistency", o.consistency, o.consistency >= 0, "not negative");
    check_number("contradiction", o.contradiction, o.contradiction > 0, "positive");
    check_number("max_cost", o.max_cost, o.max_cost > 0, "positive");
    check_number("agreement", o.agreement, o.agreement > 0, "positive");
    check_number("min_views", o.min_views, o.min_views >= 0, "not negative");
}

void check_cameras(const std::vector<StereoCamera>& cameras) {
    require(cameras.size() >= 2, "stereo: " + std::to_string(cameras.size()) + " cameras, expected at least 2");
    for (std::size_t c = 0; c < cameras.size(); ++c) {
        const StereoCamera& camera = cameras[c];
        const std::string name = std::string("cameras[").append(std::to_string(c)).append("]");
        check_finite("stereo", name + ".K", camera.K);
        check_finite("stereo", name + ".T_camera_world", camera.T_camera_world);
        require(camera.K(0, 0) > 0 && camera.K(1, 1) > 0 && camera.K(1, 0) == 0 &&
                    camera.K.row(2) == Eigen::RowVector3d(0, 0, 1),
                "stereo: " + name + ".K is no camera matrix: positive focal lengths, K[1, 0] = 0, K[2] = (0, 0, 1)");
        const Mat3 R = camera.T_camera_world.topLeftCorner<3, 3>();
        require((R * R.transpose() - Mat3::Identity()).cwiseAbs().maxCoeff() < 1e-4 && R.determinant() > 0,
                "stereo: " + name + ".T_camera_world: its upper left is not a rotation");
        require(camera.height >= LEAST_SIDE && camera.width >= LEAST_SIDE && camera.height <= LARGEST_SIDE &&
                    camera.width <= LARGEST_SIDE,
                "stereo: " + name + " has pictures of " + std::to_string(camera.height) + " x " +
                    std::to_string(camera.width) + " pixels, expected 8 to 16384 a side");
    }
}

void check_pictures(const std::vector<StereoCamera>& cameras, const StereoPictures& pictures, const Matrix& ranges) {
    const std::size_t plane = static_cast<std::size_t>(pictures.height) * pictures.width;
    for (std::size_t c = 0; c < cameras.size(); ++c) {
        const std::string name = std::string("[").append(std::to_string(c)).append("]");
        require(cameras[c].height <= pictures.height && cameras[c].width <= pictures.width,
                "stereo: images" + name + " is smaller than cameras" + name);
        const float* grey = pictures.grey + c * plane;
        require(std::all_of(grey, grey + plane, [](float value) { return value >= 0 && value <= 255; }),
                "stereo: images" + name + " has a value that is not within 0 to 255");
        const auto i = static_cast<Eigen::Index>(c);
        require((ranges(i, 0) == 0 && ranges(i, 1) == 0) ||
                    (ranges(i, 0) > 0 && ranges(i, 1) > ranges(i, 0) && std::isfinite(ranges(i, 1))),
                "stereo: depth_range" + name + " is (" + std::to_string(ranges(i, 0)) + ", " +
                    std::to_string(ranges(i, 1)) + "), expected 0 < nearest < farthest < inf");
    }
}

struct Level {
    int height, width;
    std::vector<float> grey;
    std::vector<std::uint8_t> mask;
};

Level cut(const StereoPictures& pictures, std::size_t c, const StereoCamera& camera) {
    Level out{camera.height, camera.width, {}, {}};
    for (int y = 0; y < out.height; ++y) {
        const std::size_t from = (c * pictures.height + y) * pictures.width;
        out.grey.insert(out.grey.end(), pictures.grey + from, pictures.grey + from + out.width);
        out.mask.insert(out.mask.end(), pictures.mask + from, pictures.mask + from + out.width);
    }
    return out;
}

/// Means of 2 x 2 pixels; a mask holds a pixel that holds any of its four.
Level half(const Level& fine) {
    Level out{(fine.height + 1) / 2, (fine.width + 1) / 2, {}, {}};
    out.grey.reserve(static_cast<std::size_t>(out.height) * out.width);
    out.mask.reserve(out.grey.capacity());
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            const int x1 = std::min(2 * x + 1, fine.width - 1), y1 = std::min(2 * y + 1, fine.height - 1);
            const auto at = [&](int i, int j) { return static_cast<std::size_t>(i) * fine.width + j; };
            const std::array<std::size_t, 4> four{at(2 * y, 2 * x), at(2 * y, x1), at(y1, 2 * x), at(y1, x1)};
            float sum = 0;
            std::uint8_t any = 0;
            for (const std::size_t k : four) sum += fine.grey[k], any |= fine.mask[k];
            out.grey.push_back(0.25F * sum);
            out.mask.push_back(any ? 1 : 0);
        }
    return out;
}

int level_count(const std::vector<StereoCamera>& cameras, const StereoOptions& options) {
    int longest = 0, levels = 1;
    for (const StereoCamera& camera : cameras) longest = std::max({longest, camera.height, camera.width});
    for (; longest > options.coarsest; longest = (longest + 1) / 2) ++levels;
    return levels;
}

/// Views of each level, finest first.
std::vector<std::vector<View>> make_pyramid(const std::vector<StereoCamera>& cameras, const StereoPictures& pictures,
                                            int levels) {
    std::vector<std::vector<View>> pyramid(levels);
    for (std::size_t c = 0; c < cameras.size(); ++c) {
        Level level = cut(pictures, c, cameras[c]);
        for (int l = 0; l < levels; ++l) {
            if (l > 0) level = half(level);
            pyramid[l].push_back({Picture(level.height, level.width, level.grey, level.mask),
                                  halved(cameras[c].K, l),
                                  cameras[c].T_camera_world,
                                  {}});
        }
    }
    return pyramid;
}

void list_pixels(Field& field, const Picture& picture) {
    for (auto& pixels : field.pixels) pixels.clear();
    field.slots.assign(picture.mask.size(), -1);
    int count = 0;
    for (int y = 0; y < picture.height; ++y)
        for (int x = 0; x < picture.width; ++x)
            if (picture.mask[picture.index(x, y)] && field.bound(x, y).high > 0) {
                field.pixels[(x + y) & 1].push_back(static_cast<int>(picture.index(x, y)));
                field.slots[picture.index(x, y)] = count++;
            }
    field.cells.assign(count, {});
    field.planes.assign(count, {});
}

/// The next finer level begins with each parent's plane, continued to the child's centre. Each listed pixel's parent is listed:
/// its mask holds any of four, and both have one bound.
void refine_field(Field& field, const Picture& coarse, const Picture& fine) {
    const std::vector<Cell> parents = std::move(field.cells);
    const std::vector<int> slots = std::move(field.slots);
    ++field.shift;
    list_pixels(field, fine);
    for (const auto& pixels : field.pixels)
        for (const int pixel : pixels) {
            const int x = pixel % fine.width, y = pixel / fine.width;
            Plane plane = parents[slots[coarse.index(x / 2, y / 2)]].plane;
            plane.wx *= 0.5F;
            plane.wy *= 0.5F;
            field.cells[field.slots[pixel]].plane = plane.moved(x % 2 ? 0.5F : -0.5F, y % 2 ? 0.5F : -0.5F);
        }
}

/// What the other cameras compare with from now on.
void publish(std::vector<Field>& fields) {
    for (Field& field : fields)
        for (std::size_t k = 0; k < field.cells.size(); ++k) field.planes[k] = field.cells[k].plane;
}

/// One call of PatchMatch over all cameras.
struct Round {
    int iterations;
    bool geometric, start;
    float reach;  ///< of the first iteration's random steps, halved from one to the next [px]
};

std::uint64_t key_of(std::uint64_t seed, std::size_t view, int level, int round, int iteration) {
    return (((seed * 1009 + view) * 31 + static_cast<std::uint64_t>(level)) * 7 + static_cast<std::uint64_t>(round)) *
               101 +
           static_cast<std::uint64_t>(iteration);
}

void play(const std::vector<View>& views, std::vector<Field>& fields, const Round& round, int level, int number,
          float spacing, const StereoOptions& options) {
    for (std::size_t c = 0; c < views.size(); ++c) {
        const Search search(views, fields, c, spacing, round.geometric, options);
        if (round.start)
            search.start(fields[c], key_of(options.seed, c, level, number, 0));
        else
            search.weigh(fields[c]);
        for (int i = 0; i < round.iterations; ++i)
            search.sweep(fields[c], round.reach * std::ldexp(1.0F, -i), key_of(options.seed, c, level, number, i + 1));
    }
    publish(fields);
}

Vec3 world_normal(const View& view, const Plane& plane, int x, int y) {
    const Vec3 slopes(plane.wx, plane.wy, plane.w - plane.wx * (x + 0.5F) - plane.wy * (y + 0.5F));
    return -(view.T.topLeftCorner<3, 3>().transpose() * (view.K.transpose() * slopes)).normalized();
}

/// The finished maps of one camera.
void write_maps(const std::vector<View>& views, const std::vector<Field>& fields, std::size_t c, float spacing,
                const StereoOptions& options, const StereoPictures& size, StereoMaps& maps) {
    const View& view = views[c];
    const Search search(views, fields, c, spacing, true, options);
    const auto judge = [&](int pixel) {
        const int x = pixel % view.picture.width, y = pixel / view.picture.width;
        const std::size_t at = (c * size.height + y) * size.width + x;
        const auto leave = [&](Hole why) { maps.hole[at] = static_cast<std::uint8_t>(why); };
        const Window window = search.window(x, y);
        if (window.variance < std::pow(PLAIN * options.noise, 2))
            return leave(window.mean > WHITE || window.mean < BLACK ? Hole::saturated : Hole::untextured);
        const Plane& plane = fields[c].planes[fields[c].slots[pixel]];
        const Opinion opinion = search.opinion(window, x, y, plane);
        if (!(opinion.colour < options.max_cost)) return leave(Hole::unmatched);
        int agree = 0;
        for (const Pair& pair : view.pairs) {
            const Warp warp(pair, static_cast<float>(x), static_cast<float>(y), plane);
            agree += search.disagreement(pair, warp, plane.w) < options.agreement;
        }
        if (agree < options.min_views) return leave(Hole::inconsistent);
        leave(Hole::none);
        maps.depth[at] = 1 / plane.w;
        const Vec3 normal = world_normal(view, plane, x, y);
        for (int k = 0; k < 3; ++k) maps.normal[3 * at + k] = static_cast<float>(normal[k]);
        const float alike = std::clamp(1 - opinion.colour / static_cast<float>(options.max_cost), 0.0F, 1.0F);
        maps.confidence[at] = alike * static_cast<float>(agree + 1) / static_cast<float>(agree + 2);
    };
    for (const auto& pixels : fields[c].pixels)
        parallel_for(static_cast<std::int64_t>(pixels.size()), [&](std::int64_t k) { judge(pixels[k]); });
}

}  // namespace

StereoSolver::StereoSolver(std::vector<StereoCamera> cameras, const StereoOptions& options)
    : cameras_(std::move(cameras)), options_(options) {
    check_options(options_);
    check_cameras(cameras_);
}

StereoMaps StereoSolver::solve(const StereoPictures& pictures, const Matrix& ranges) const {
    check_pictures(cameras_, pictures, ranges);
    const int levels = level_count(cameras_, options_);
    std::vector<std::vector<View>> pyramid = make_pyramid(cameras_, pictures, levels);
    std::vector<View>& coarsest = pyramid.back();
    const Scene scene =
        (ranges.col(1).array() > 0).all() ? scene_of_ranges(coarsest, ranges) : scene_of_masks(coarsest);
    require(scene.centre.allFinite() && scene.radius > 0,
            "stereo: the masks are empty, or the cameras see no common place");
    const auto sources = choose_sources(coarsest, scene, options_);
    for (auto& views : pyramid)
        for (std::size_t c = 0; c < views.size(); ++c)
            for (const int s : sources[c]) views[c].pairs.push_back(make_pair(views[c], views[s], s));

    std::vector<Field> fields(cameras_.size());
    for (std::size_t c = 0; c < fields.size(); ++c) {
        fields[c].bounds_width = coarsest[c].picture.width;
        fields[c].bounds = sources[c].empty()
                               ? std::vector<Bounds>(coarsest[c].picture.mask.size())
                               : bound_depths(coarsest, c, scene, ranges.row(static_cast<Eigen::Index>(c)));
        list_pixels(fields[c], coarsest[c].picture);
    }
    const auto finest = static_cast<float>(options_.spacing);
    for (int level = levels - 1; level >= 0; --level) {
        const std::vector<View>& views = pyramid[level];
        const float spacing = level > 0 ? COARSE_SPACING * finest : finest;
        if (level == levels - 1) {
            play(views, fields, {options_.start_iterations, false, true, 4}, level, 0, spacing, options_);
        } else {
            for (std::size_t c = 0; c < fields.size(); ++c)
                refine_field(fields[c], pyramid[level + 1][c].picture, views[c].picture);
            pyramid.pop_back();
            publish(fields);
        }
        const int iterations = level > 0 ? options_.coarse_iterations : options_.iterations;
        play(views, fields, {iterations, true, false, 1}, level, 1, spacing, options_);
    }
    for (Field& field : fields) field.bounds = {};  // asked no more: room for the bends
    for (int k = 0; k < options_.refinements; ++k) {
        for (std::size_t c = 0; c < fields.size(); ++c) {
            const Search search(pyramid[0], fields, c, finest, true, options_);
            search.bend(fields[c]);
            search.refine(fields[c], STEPS);
        }
        publish(fields);
    }
    for (Field& field : fields) field.cells = {};  // `planes` are the same: room for the maps
    const std::size_t count = cameras_.size() * pictures.height * pictures.width;
    constexpr float none = std::numeric_limits<float>::quiet_NaN();
    StereoMaps maps{std::vector<float>(count, none), std::vector<float>(3 * count, none), std::vector<float>(count, 0),
                    std::vector<std::uint8_t>(count, static_cast<std::uint8_t>(Hole::masked))};
    for (std::size_t c = 0; c < fields.size(); ++c) {
        write_maps(pyramid[0], fields, c, finest, options_, pictures, maps);
        fields[c].bends = {};
    }
    return maps;
}

}  // namespace toile
