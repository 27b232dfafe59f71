#include "kernels/contours.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "base/errors.h"
#include "base/parallel.h"

namespace toile {

namespace {

constexpr std::int64_t GRAIN = 8;  // rows
constexpr std::int64_t POINTS = 1024;

void check(const ContourView& v, double near_plane) {
    check_mesh("contours", v.vertices_camera, v.faces, "vertices_camera", "F");
    check_finite("contours", "K", v.K);
    require(v.K(0, 0) > 0 && v.K(1, 1) > 0 && v.K(1, 0) == 0 && v.K.row(2) == Eigen::RowVector3d(0, 0, 1),
            "contours: K is not a camera matrix");
    require(std::isfinite(near_plane) && near_plane > 0,
            "contours: near_plane is " + std::to_string(near_plane) + ", expected a positive distance");
    require(v.depth.rows() == v.face.rows() && v.depth.cols() == v.face.cols(),
            "contours: depth and face differ in shape");
    require(v.of.size() == 0 || (v.of.rows() == v.face.rows() && v.of.cols() == v.face.cols()),
            "contours: of and face differ in shape");
    require(v.neighbours.rows() == v.faces.rows(), "contours: neighbours has " + std::to_string(v.neighbours.rows()) +
                                                       " rows, F " + std::to_string(v.faces.rows()));
    const auto within = [&](const auto& faces, const char* name) {
        require(faces.size() == 0 || (faces.minCoeff() >= -1 && faces.maxCoeff() < v.faces.rows()),
                std::string("contours: ") + name + " has an index out of -1.." + std::to_string(v.faces.rows() - 1));
    };
    within(v.face, "face");
    within(v.neighbours, "neighbours");
}

/// Where a vertex lies on the image, seen along a step from one pixel's centre to the next [px].
struct Place {
    double ahead, aside;
};

/// Twice the signed area.
double turn(const Place& i, const Place& j, const Place& v) {
    return (j.ahead - i.ahead) * (v.aside - i.aside) - (j.aside - i.aside) * (v.ahead - i.ahead);
}

/// Both left, or both right, of the edge that they were measured from.
bool same_side(double one, double other) { return (one > 0 && other > 0) || (one < 0 && other < 0); }

struct End {
    std::int32_t i, j;
    double share;
};

/// A surface followed from a pixel's centre.
struct Followed {
    std::optional<End> end;  ///< where it ends or turns back within the step
    std::int32_t face;       ///< where it was left
};

class Follower {
public:
    Follower(const ContourView& view, double near_plane) : view_(view), near_(near_plane) {}

    /// From the centre (x, y) in `face` by one pixel along (dx, dy).
    Followed follow(std::int32_t face, double x, double y, double dx, double dy) const {
        const auto place = [&](std::int32_t v) {
            const Vec3 p = view_.vertices_camera.row(v);
            const double u = view_.K.row(0).dot(p) / depth(v) - x, w = view_.K.row(1).dot(p) / depth(v) - y;
            return Place{u * dx + w * dy, w * dx - u * dy};
        };
        const Faces& F = view_.faces;
        std::array<Place, 3> at{place(F(face, 0)), place(F(face, 1)), place(F(face, 2))};
        int inner = way_out(at);  // the line leaves the face by the edge opposite this corner
        for (int count = 0; inner >= 0 && count < Contours::most_faces; ++count) {
            const int ki = (inner + 1) % 3, kj = (inner + 2) % 3;
            const Place p = at[ki], q = at[kj];
            const double share = p.aside / (p.aside - q.aside);
            if (!(std::abs(p.ahead + share * (q.ahead - p.ahead)) <= 1)) break;
            const std::int32_t i = F(face, ki), j = F(face, kj), beyond = view_.neighbours(face, inner);
            const int outer = beyond < 0 ? -1 : opposite(beyond, i, j);
            if (outer < 0) return {End{i, j, perspective(i, j, share)}, face};
            const Place o = place(F(beyond, outer));
            if (same_side(turn(p, q, at[inner]), turn(p, q, o))) return {End{i, j, perspective(i, j, share)}, face};
            const bool replaces_i = (p.aside >= 0) == (o.aside >= 0);
            for (int k = 0; k < 3; ++k) at[k] = k == outer ? o : F(beyond, k) == i ? p : q;
            for (int k = 0; k < 3; ++k)
                if (k != outer && (F(beyond, k) == i) == replaces_i) inner = k;
            face = beyond;
        }
        return {std::nullopt, face};
    }

private:
    double depth(std::int64_t v) const { return std::max(view_.vertices_camera(v, 2), near_); }

    /// The corner of a face that is neither i nor j, -1 where it does not have all three.
    int opposite(std::int32_t face, std::int32_t i, std::int32_t j) const {
        const auto corner = view_.faces.row(face);
        for (int k = 0; k < 3; ++k) {
            const std::int32_t p = corner[(k + 1) % 3], q = corner[(k + 2) % 3];
            if ((p == i && q == j) || (p == j && q == i)) return i == j ? -1 : k;
        }
        return -1;
    }

    /// The corner opposite the edge by which the line ahead leaves a triangle, -1 where it misses it.
    static int way_out(const std::array<Place, 3>& at) {
        int out = -1;
        double farthest = 0;
        for (int k = 0; k < 3; ++k) {
            const Place &p = at[(k + 1) % 3], &q = at[(k + 2) % 3];
            if ((p.aside >= 0) == (q.aside >= 0)) continue;
            const double ahead = p.ahead + p.aside / (p.aside - q.aside) * (q.ahead - p.ahead);
            if (out < 0 || ahead > farthest) out = k, farthest = ahead;
        }
        return out;
    }

    /// The share of j in space, of that on the image.
    double perspective(std::int32_t i, std::int32_t j, double share) const {
        const double near_j = share * depth(i), near_i = (1 - share) * depth(j);
        return near_j / (near_j + near_i);
    }

    const ContourView& view_;
    double near_;
};

/// The contour between pixel (row, column) and the one to its right, or below.
std::optional<ContourPoint> between(const ContourView& view, const Follower& follower, Eigen::Index row,
                                    Eigen::Index column, bool below) {
    const Eigen::Index row_b = row + below, column_b = column + !below;
    if (view.of.size() > 0 && !view.of(row, column) && !view.of(row_b, column_b)) return {};
    const std::int32_t p = view.face(row, column), q = view.face(row_b, column_b);
    if (p == q) return {};
    if (p >= 0 && q >= 0)
        for (int k = 0; k < 3; ++k)
            for (int l = 0; l < 3; ++l)
                if (view.faces(p, k) == view.faces(q, l)) return {};
    const double dx = !below, dy = below;
    const auto from = [&](bool b) {
        const double x = static_cast<double>(b ? column_b : column) + 0.5,
                     y = static_cast<double>(b ? row_b : row) + 0.5;
        const std::int32_t face = b ? q : p;
        return face < 0 ? Followed{std::nullopt, -1} : follower.follow(face, x, y, b ? -dx : dx, b ? -dy : dy);
    };
    const bool b_nearer = view.depth(row_b, column_b) < view.depth(row, column);
    Followed found = from(b_nearer);
    if (!found.end && found.face >= 0 && found.face == (b_nearer ? p : q)) return {};  // one surface goes through
    if (!found.end) found = from(!b_nearer);
    if (!found.end) return {};
    const auto pixel = [&](Eigen::Index r, Eigen::Index c) {
        return static_cast<std::int32_t>(r * view.face.cols() + c);
    };
    return ContourPoint{pixel(row, column), pixel(row_b, column_b), found.end->i,
                        found.end->j,       found.end->share,       below};
}

}  // namespace

Contours::Contours(const ContourView& view, double near_plane)
    : vertices_(view.vertices_camera), K_(view.K), near_(near_plane), pixels_(view.face.size()) {
    check(view, near_plane);
    const Follower follower(view, near_plane);
    const Eigen::Index height = view.face.rows(), width = view.face.cols();
    std::vector<std::vector<ContourPoint>> rows(static_cast<std::size_t>(height));
    parallel_for(height, [&](std::int64_t row) {
        for (Eigen::Index column = 0; column < width; ++column) {
            if (column + 1 < width)
                if (const auto point = between(view, follower, row, column, false)) rows[row].push_back(*point);
            if (row + 1 < height)
                if (const auto point = between(view, follower, row, column, true)) rows[row].push_back(*point);
        }
    }, GRAIN);
    for (const auto& row : rows) points_.insert(points_.end(), row.begin(), row.end());
}

Vertices Contours::gradient(const Eigen::Ref<const Planes>& picture, const Eigen::Ref<const Planes>& g) const {
    require(picture.cols() == pixels_ && g.cols() == pixels_ && g.rows() == picture.rows(),
            "contours: picture and g are not (C,H*W) of this view");
    std::vector<Eigen::RowVector3d> force(points_.size());  // by the point's place
    parallel_for(static_cast<std::int64_t>(points_.size()), [&](std::int64_t e) {
        const auto& [a, b, i, j, share, below] = points_[e];
        double slope = 0;  // by the point's place on the image
        for (Eigen::Index c = 0; c < picture.rows(); ++c) {
            const double step = static_cast<double>(picture(c, a)) - picture(c, b);
            if (std::isfinite(step)) slope += 0.5 * (static_cast<double>(g(c, a)) + g(c, b)) * step;
        }
        const Eigen::RowVector3d point = (1 - share) * vertices_.row(i) + share * vertices_.row(j),
                                 axis = K_.row(below);
        const double z = std::max(point[2], near_);
        force[e] << axis[0], axis[1], -(axis[0] * point[0] + axis[1] * point[1]) / z;
        force[e] *= slope / z;
    }, POINTS);
    Vertices gradient = Vertices::Zero(vertices_.rows(), 3);
    for (std::size_t e = 0; e < points_.size(); ++e) {
        const ContourPoint& point = points_[e];
        gradient.row(point.i) += (1 - point.share) * force[e];
        gradient.row(point.j) += point.share * force[e];
    }
    return gradient;
}

}  // namespace toile
