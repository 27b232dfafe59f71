#include "kernels/remesh.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/detect_features.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/remesh.h>
#include <CGAL/Surface_mesh.h>

#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <vector>

#include "base/errors.h"
#include "geometry/laplacian.h"
#include "geometry/weld.h"

namespace toile {

namespace {

namespace processing = CGAL::Polygon_mesh_processing;
using Point = CGAL::Exact_predicates_inexact_constructions_kernel::Point_3;
using Mesh = CGAL::Surface_mesh<Point>;

constexpr double most_faces = 1e7;

void check_options(const RemeshOptions& o, double edge) {
    require(std::isfinite(edge) && edge > 0,
            "remesh: edge is " + std::to_string(edge) + ", expected a positive length");
    require(o.iterations >= 1 && o.iterations <= 100,
            "remesh: iterations is " + std::to_string(o.iterations) + ", expected 1 to 100");
    require(o.crease_angle > 0 && o.crease_angle <= M_PI,
            "remesh: crease_angle is " + std::to_string(o.crease_angle) + ", expected 0 to pi");
}

/// `X` in edges: both the area and the sides, which a needle has without any area, bound what will be made.
void check_size(const Vertices& X, const Faces& F) {
    const double area = face_areas(X, F).sum();
    require(area > 0, "remesh: the faces of V have no area");
    double sides = 0;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) sides += (X.row(F(f, c)) - X.row(F(f, (c + 1) % 3))).norm();
    require(area / (std::sqrt(3.0) / 4) <= most_faces && sides <= most_faces,
            "remesh: edge is so short that it makes more than 10 million faces");
}

/// Sides shorter than 1e-6 edges shrink to their end of the smaller number; what is left of no height is refused.
Faces without_points(const Vertices& X, const Faces& F) {
    constexpr double point = 1e-6, flat = 1e-10;  // edges; share of the longest side
    std::vector<int> to(static_cast<std::size_t>(X.rows()));
    std::iota(to.begin(), to.end(), 0);
    const auto end_of = [&](int v) {
        while (to[v] != v) v = to[v] = to[to[v]];
        return v;
    };
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = end_of(F(f, c)), j = end_of(F(f, (c + 1) % 3));
            if ((X.row(F(f, c)) - X.row(F(f, (c + 1) % 3))).norm() < point) to[std::max(i, j)] = std::min(i, j);
        }
    const Faces ends = F.unaryExpr(end_of);
    for (Eigen::Index f = 0; f < ends.rows(); ++f) {
        const Vec3 a = X.row(ends(f, 0)), b = X.row(ends(f, 1)), c = X.row(ends(f, 2));
        const double longest = std::max({(b - a).squaredNorm(), (c - b).squaredNorm(), (a - c).squaredNorm()});
        const bool point_like = ends(f, 0) == ends(f, 1) || ends(f, 1) == ends(f, 2) || ends(f, 2) == ends(f, 0);
        if (!point_like && (b - a).cross(c - a).norm() <= flat * longest)
            throw InputError("remesh: the corners of face " + std::to_string(f) +
                             " (repeated faces left out) lie on a line");
    }
    return distinct_faces(ends, X.rows());
}

Mesh mesh_of(const Vertices& X, const Faces& F) {
    std::vector<int> number(static_cast<std::size_t>(X.rows()), -1);
    std::vector<Point> points;
    std::vector<std::array<std::size_t, 3>> faces(static_cast<std::size_t>(F.rows()));
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            int& v = number[static_cast<std::size_t>(F(f, c))];
            if (v < 0) {
                v = static_cast<int>(points.size());
                points.emplace_back(X(F(f, c), 0), X(F(f, c), 1), X(F(f, c), 2));
            }
            faces[static_cast<std::size_t>(f)][c] = static_cast<std::size_t>(v);
        }
    require(processing::is_polygon_soup_a_polygon_mesh(faces),
            "remesh: F is no surface: an edge of three faces, neighbours that run opposite ways, or parts that share "
            "one vertex only");
    Mesh mesh;
    processing::polygon_soup_to_polygon_mesh(points, faces, mesh);
    return mesh;
}

RemeshResult result_of(Mesh& mesh) {
    mesh.collect_garbage();
    RemeshResult r{Vertices(mesh.number_of_vertices(), 3), Faces(mesh.number_of_faces(), 3)};
    for (const auto v : mesh.vertices()) {
        const Point& p = mesh.point(v);
        r.V.row(v.idx()) << p.x(), p.y(), p.z();
    }
    for (const auto f : mesh.faces()) {
        int c = 0;
        for (const auto v : mesh.vertices_around_face(mesh.halfedge(f))) r.F(f.idx(), c++) = static_cast<int>(v.idx());
    }
    return r;
}

}  // namespace

RemeshResult remesh(const Vertices& V, const Faces& F, double edge, const RemeshOptions& options) {
    check_mesh("remesh", V, F);
    check_options(options, edge);
    const Faces faces = distinct_faces(F, V.rows());
    require(faces.rows() > 0, "remesh: F has no face of three different vertices");
    const Eigen::RowVector3d origin = V.row(faces(0, 0));
    const Vertices X = (V.rowwise() - origin) / edge;
    check_size(X, faces);
    Mesh mesh = mesh_of(X, without_points(X, faces));
    auto kept = mesh.add_property_map<Mesh::Edge_index, bool>("e:kept", false).first;
    processing::detect_sharp_edges(mesh, options.crease_angle * 180 / M_PI, kept);
    try {
        processing::isotropic_remeshing(
            mesh.faces(), 1.0, mesh,
            CGAL::parameters::number_of_iterations(options.iterations).edge_is_constrained_map(kept));
    } catch (const std::exception& error) {
        throw SolveError(std::string("remesh: CGAL gave up: ") + error.what());
    }
    RemeshResult result = result_of(mesh);
    result.V = (result.V * edge).rowwise() + origin;
    check_solved("remesh", "V", result.V);
    return result;
}

}  // namespace toile
