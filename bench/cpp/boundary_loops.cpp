// Boundary loops by the core's own count of edges, by OpenMesh's and by CGAL's half-edges, from the same arrays. Built and
// called by bench/libraries.py.
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>
#include <pybind11/eigen.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>
#include <chrono>

#include "geometry/topology.h"

namespace py = pybind11;
using namespace toile;

namespace {

struct Found {
    std::vector<std::vector<int>> loops;
    std::int64_t refused = 0;  // faces that the structure cannot hold
};

Found own(const Faces& F, int) { return {boundary_loops(F)}; }

Found open_mesh(const Faces& F, int n) {
    OpenMesh::TriMesh_ArrayKernelT<> mesh;
    mesh.reserve(n, 3 * F.rows() / 2, F.rows());
    for (int v = 0; v < n; ++v) mesh.add_vertex({0, 0, 0});
    Found found;
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        const auto face = mesh.add_face(OpenMesh::VertexHandle(F(f, 0)), OpenMesh::VertexHandle(F(f, 1)),
                                        OpenMesh::VertexHandle(F(f, 2)));
        found.refused += !face.is_valid();
    }
    std::vector<char> seen(mesh.n_halfedges(), 0);
    for (const auto h : mesh.halfedges()) {
        if (!h.is_boundary() || seen[h.idx()]) continue;
        std::vector<int> loop;
        for (auto at = h; !seen[at.idx()]; at = at.next()) seen[at.idx()] = 1, loop.push_back(at.to().idx());
        found.loops.push_back(std::move(loop));
    }
    return found;
}

Found cgal(const Faces& F, int n) {
    using Mesh = CGAL::Surface_mesh<CGAL::Simple_cartesian<double>::Point_3>;
    Mesh mesh;
    mesh.reserve(n, 3 * F.rows() / 2, F.rows());
    for (int v = 0; v < n; ++v) mesh.add_vertex({});
    Found found;
    using Vertex = Mesh::Vertex_index;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        found.refused += mesh.add_face(Vertex(F(f, 0)), Vertex(F(f, 1)), Vertex(F(f, 2))) == Mesh::null_face();
    std::vector<char> seen(mesh.num_halfedges(), 0);
    for (const auto h : mesh.halfedges()) {
        if (!mesh.is_border(h) || seen[h]) continue;
        std::vector<int> loop;
        for (auto at = h; !seen[at]; at = mesh.next(at)) seen[at] = 1, loop.push_back(mesh.target(at));
        found.loops.push_back(std::move(loop));
    }
    return found;
}

template <class Find>
py::tuple timed(Find&& find, const Faces& F, int n) {
    const auto start = std::chrono::steady_clock::now();
    const Found found = find(F, n);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return py::make_tuple(seconds, found.loops, found.refused);
}

}  // namespace

PYBIND11_MODULE(boundary_loops, m) {
    m.def("own", [](const Faces& F, int n) { return timed(own, F, n); });
    m.def("openmesh", [](const Faces& F, int n) { return timed(open_mesh, F, n); });
    m.def("cgal", [](const Faces& F, int n) { return timed(cgal, F, n); });
}
