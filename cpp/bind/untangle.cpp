#include "kernels/untangle.h"

#include "bind/common.h"

namespace toile::bind {

void bind_untangle(py::module_& m) {
    py::class_<UntangleOptions>(m, "UntangleOptions")
        .def(py::init<>())
        .def_readwrite("margin", &UntangleOptions::margin)
        .def_readwrite("spread", &UntangleOptions::spread)
        .def_readwrite("relative_tolerance", &UntangleOptions::relative_tolerance)
        .def_readwrite("max_depth", &UntangleOptions::max_depth)
        .def_readwrite("max_iterations", &UntangleOptions::max_iterations);
    py::class_<UntangleResult>(m, "UntangleResult")
        .def_readonly("V", &UntangleResult::V)
        .def_readonly("displacement", &UntangleResult::displacement)
        .def_readonly("depth_before", &UntangleResult::depth_before)
        .def_readonly("depth_after", &UntangleResult::depth_after)
        .def_readonly("margin", &UntangleResult::margin)
        .def_readonly("pairs_left", &UntangleResult::pairs_left)
        .def_readonly("intersections_before", &UntangleResult::intersections_before)
        .def_readonly("intersections_left", &UntangleResult::intersections_left)
        .def_readonly("vertices_left", &UntangleResult::vertices_left)
        .def_readonly("vertices_short", &UntangleResult::vertices_short)
        .def_readonly("iterations", &UntangleResult::iterations)
        .def_readonly("stop", &UntangleResult::stop)
        .def_readonly("reason", &UntangleResult::reason)
        .def(as_tuple_of(&UntangleResult::V, &UntangleResult::displacement, &UntangleResult::depth_before,
                         &UntangleResult::depth_after, &UntangleResult::margin, &UntangleResult::pairs_left,
                         &UntangleResult::intersections_before, &UntangleResult::intersections_left,
                         &UntangleResult::vertices_left, &UntangleResult::vertices_short, &UntangleResult::iterations,
                         &UntangleResult::stop, &UntangleResult::reason));
    py::class_<UntangleSolver>(m, "UntangleSolver")
        .def(py::init([](const Faces& cloth_F, Eigen::Index cloth_n, const Faces& body_F, Eigen::Index body_n,
                         const py::kwargs& options) {
        const auto chosen = options_from<UntangleOptions>(options, "untangle");
        const Unlocked unlocked;
        return std::make_unique<UntangleSolver>(cloth_F, cloth_n, body_F, body_n, chosen);
    })).def("solve", &UntangleSolver::solve, py::call_guard<Unlocked>());
}

}  // namespace toile::bind
