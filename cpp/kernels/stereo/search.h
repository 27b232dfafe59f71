// PatchMatch on one level: every pixel's plane, spread and varied over a checkerboard.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "kernels/stereo/rig.h"

namespace toile::stereo {

struct Cell {
    Plane plane;
    float cost = 0;
};

/// What one camera knows on one level of those pixels that have bounds, row by row: a person fills a quarter of its box.
/// `planes` are those that the other cameras compare with, of the round before; w = 0 where there is none.
struct Field {
    std::vector<int> slots;  ///< of each pixel of the picture its place in the lists below; -1: it has no bounds
    std::vector<Cell> cells;
    std::vector<Plane> planes;
    std::vector<Bend> bends;                 ///< of the surface at each pixel; empty: planes alone
    std::array<std::vector<int>, 2> pixels;  ///< that have bounds, by colour of the checkerboard
    std::vector<Bounds> bounds;              ///< of all pixels of the coarsest level
    int shift = 0;                           ///< levels from this one to the coarsest
    int bounds_width = 0;

    const Bounds& bound(int x, int y) const {
        return bounds[static_cast<std::size_t>(y >> shift) * bounds_width + static_cast<std::size_t>(x >> shift)];
    }
};

/// What the other cameras say of one pixel's plane.
struct Opinion {
    float cost;    ///< photometric and geometric, mean of the best
    float colour;  ///< 1 - correlation alone, of the same cameras
    std::array<int, 16> order;
    int counted;  ///< the first of `order` that count
};

/// Costs and moves of one camera's pixels on one level.
class Search {
public:
    Search(const std::vector<View>& views, const std::vector<Field>& fields, std::size_t own, float spacing,
           bool geometric, const StereoOptions& options);

    Opinion opinion(const Window& window, int x, int y, const Plane& plane) const;

    /// Disparity [px] between a pixel's plane and that of the pair's other camera; `contradiction` or more, up to
    /// infinity, where that has none.
    float disagreement(const Pair& pair, const Warp& warp, float w) const;

    /// Random planes within the bounds, the best of a few.
    void start(Field& field, std::uint64_t key) const;
    /// Costs of the planes that are there.
    void weigh(Field& field) const;
    /// One iteration: both colours. `reach` [px] is how far a random step moves a disparity.
    void sweep(Field& field, float reach, std::uint64_t key) const;
    /// How the surface bends at each pixel, by the depths about it.
    void bend(Field& field) const;
    /// Gauss-Newton on the grey values of the best cameras; a step is taken where it lowers the cost.
    void refine(Field& field, int steps) const;

    Window window(int x, int y) const;

private:
    float scale(int x, int y, const Plane& plane) const;
    void visit(Field& field, int pixel, float reach, std::uint64_t key) const;

    const std::vector<View>& views_;
    const std::vector<Field>& fields_;
    const View& view_;
    const Field& own_;
    Grid grid_;
    bool geometric_;
    const StereoOptions& options_;
    float noise2_;
};

}  // namespace toile::stereo
