#include <cmath>

#include "base/errors.h"
#include "base/sparse.h"
#include "bind/common.h"
#include "geometry/closest.h"
#include "geometry/laplacian.h"
#include "geometry/path.h"
#include "geometry/topology.h"

namespace toile::bind {

namespace {

/// (face, point, barycentric, distance) as arrays.
py::tuple arrays_of(const std::vector<SurfacePoint>& hits) {
    const auto n = static_cast<Eigen::Index>(hits.size());
    Indices face(n);
    Vertices point(n, 3), barycentric(n, 3);
    Vector distance(n);
    for (Eigen::Index i = 0; i < n; ++i) {
        const SurfacePoint& h = hits[static_cast<std::size_t>(i)];
        face[i] = h.face;
        point.row(i) = h.point;
        barycentric.row(i) = h.barycentric;
        distance[i] = h.distance;
    }
    return py::make_tuple(face, point, barycentric, distance);
}

py::tuple closest_arrays(const SurfaceIndex& index, const Vertices& P, double radius, const Indices& guesses) {
    std::vector<SurfacePoint> hits;
    {
        const Unlocked unlocked;
        check_points("closest", "points", P);
        require(radius >= 0, "closest: radius is not a number >= 0");
        hits = index.closest_each(P, radius, guesses);
    }
    return arrays_of(hits);
}

py::tuple reached_arrays(const SurfaceIndex& index, const Vertices& P, const Indices& start) {
    std::vector<SurfacePoint> hits;
    {
        const Unlocked unlocked;
        check_points("reached", "points", P);
        hits = index.reached_each(P, start);
    }
    return arrays_of(hits);
}

constexpr Eigen::Index most_vertices = 1 << 28;  // what topology keeps per vertex is made of this size

Matrix checked_solve(const CholeskyFactor& factor, const Matrix& B) {
    check_finite("cholesky", "B", B);
    const Matrix X = factor.solve(B);
    check_solved("cholesky", "X", X);
    return X;
}

}  // namespace

void bind_geometry(py::module_& m) {
    const auto free = py::call_guard<Unlocked>();
    m.def("vertex_normals", [](const Vertices& V, const Faces& F) {
        check_mesh("vertex_normals", V, F);
        return vertex_normals(V, F);
    }, free);
    m.def("cheapest_path", &cheapest_path, free);
    m.def("face_normals", [](const Vertices& V, const Faces& F) {
        check_mesh("face_normals", V, F);
        return face_normals(V, F);
    }, free);
    m.def("face_areas", [](const Vertices& V, const Faces& F) {
        check_mesh("face_areas", V, F);
        return face_areas(V, F);
    }, free);
    m.def("cotangent_laplacian", [](const Vertices& V, const Faces& F) {
        check_mesh("cotangent_laplacian", V, F);
        return cotangent_laplacian(V, F);
    }, free);
    m.def("voronoi_mass", [](const Vertices& V, const Faces& F) {
        check_mesh("voronoi_mass", V, F);
        return voronoi_mass(V, F);
    }, free);
    m.def("boundary_loops", [](const Faces& F) {
        check_faces("boundary_loops", F, most_vertices, "F", "");
        return boundary_loops(F);
    });
    m.def("face_neighbours", [](const Faces& F) {
        check_faces("face_neighbours", F, most_vertices, "F", "");
        return face_neighbours(F);
    }, free);
    m.def("border_vertices", [](const Faces& F, Eigen::Index n) {
        require(n >= 0 && n <= most_vertices, "border_vertices: n is " + std::to_string(n));
        check_faces("border_vertices", F, n);
        const std::vector<char> mark = border_vertices(F, n);
        return Eigen::Array<bool, Eigen::Dynamic, 1>(
            Eigen::Map<const Eigen::Array<char, Eigen::Dynamic, 1>>(mark.data(), n).cast<bool>());
    }, free);
    m.def("unique_edges", [](const Faces& F) {
        check_faces("unique_edges", F, most_vertices, "F", "");
        return unique_edges(F);
    }, free);
    m.def("vertex_components", [](const Faces& F, Eigen::Index n) {
        require(n >= 0 && n <= most_vertices, "vertex_components: n is " + std::to_string(n));
        check_faces("vertex_components", F, n);
        return vertex_components(F, n);
    });
    py::class_<CholeskyFactor>(m, "CholeskyFactor")
        .def(py::init<>())
        .def("factorize", &CholeskyFactor::factorize, py::call_guard<Unlocked>())
        .def("solve", &checked_solve, py::call_guard<Unlocked>())
        .def_property_readonly("factorisations", &CholeskyFactor::factorisations)
        .def_property_readonly("analyses", &CholeskyFactor::analyses);
    py::class_<SurfaceIndex, std::shared_ptr<SurfaceIndex>>(m, "SurfaceIndex")
        .def(py::init([](const Vertices& V, const Faces& F) {
        const Unlocked unlocked;  // ended before pybind11 registers what is returned
        check_mesh("SurfaceIndex", V, F);
        return std::make_shared<SurfaceIndex>(V, F);
    }))
        .def_property_readonly("V", &SurfaceIndex::vertices)
        .def_property_readonly("F", &SurfaceIndex::faces)
        .def("closest", &closest_arrays)
        .def("reached", &reached_arrays)
        .def("occluded", [](const SurfaceIndex& index, const Vertices& origins, const Vertices& directions, double from,
                            double to) {
        require(origins.rows() == directions.rows(), "occluded: origins has " + std::to_string(origins.rows()) +
                                                         " rows, directions " + std::to_string(directions.rows()));
        check_points("occluded", "origins", origins);
        check_points("occluded", "directions", directions);
        require(!std::isnan(from) && !std::isnan(to), "occluded: near or far is not a number");
        Eigen::Array<bool, Eigen::Dynamic, 1> hit(origins.rows());
        const Unlocked unlocked;
        for (Eigen::Index i = 0; i < origins.rows(); ++i)
            hit[i] = index.occluded(origins.row(i), directions.row(i), from, to);
        return hit;
    });
}

}  // namespace toile::bind
