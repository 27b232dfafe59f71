#include "kernels/inner.h"

#include "bind/common.h"

namespace toile::bind {

void bind_inner(py::module_& m) {
    py::class_<InnerOptions>(m, "InnerOptions")
        .def(py::init<>())
        .def_readwrite("length", &InnerOptions::length)
        .def_readwrite("skin", &InnerOptions::skin)
        .def_readwrite("out", &InnerOptions::out)
        .def_readwrite("fit", &InnerOptions::fit)
        .def_readwrite("fit_scale", &InnerOptions::fit_scale)
        .def_readwrite("prior", &InnerOptions::prior)
        .def_readwrite("gap", &InnerOptions::gap)
        .def_readwrite("taper", &InnerOptions::taper)
        .def_readwrite("reach", &InnerOptions::reach)
        .def_readwrite("tightness", &InnerOptions::tightness)
        .def_readwrite("shape_sigma", &InnerOptions::shape_sigma)
        .def_readwrite("shape_observations", &InnerOptions::shape_observations)
        .def_readwrite("rounds", &InnerOptions::rounds)
        .def_readwrite("tolerance", &InnerOptions::tolerance)
        .def_readwrite("max_iterations", &InnerOptions::max_iterations);
    py::class_<InnerGarment>(m, "InnerGarment").def(py::init([](Vertices V, Faces F) {
        return InnerGarment{std::move(V), std::move(F)};
    }));
    py::class_<InnerFrame>(m, "InnerFrame")
        .def(py::init([](Vertices rotations, Vec3 translation, Vertices tracked, Vector visible,
                         std::vector<InnerGarment> garments) {
            return InnerFrame{std::move(rotations), std::move(translation), std::move(tracked), std::move(visible),
                              std::move(garments)};
        }));
    py::class_<InnerFused>(m, "InnerFused")
        .def_readonly("rest", &InnerFused::rest)
        .def_readonly("shape", &InnerFused::shape)
        .def_readonly("bound", &InnerFused::bound)
        .def_readonly("stop", &InnerFused::stop)
        .def_readonly("iterations", &InnerFused::iterations)
        .def_readonly("energy", &InnerFused::energy)
        .def_readonly("observed", &InnerFused::observed)
        .def_readonly("bounded", &InnerFused::bounded)
        .def_readonly("factorisations", &InnerFused::factorisations)
        .def(as_tuple_of(&InnerFused::rest, &InnerFused::shape, &InnerFused::bound, &InnerFused::stop,
                         &InnerFused::iterations, &InnerFused::energy, &InnerFused::observed, &InnerFused::bounded,
                         &InnerFused::factorisations));
    py::class_<InnerResult>(m, "InnerResult")
        .def_readonly("V", &InnerResult::V)
        .def_readonly("skin", &InnerResult::skin)
        .def_readonly("stop", &InnerResult::stop)
        .def_readonly("iterations", &InnerResult::iterations)
        .def_readonly("energy", &InnerResult::energy)
        .def_readonly("depth_before", &InnerResult::depth_before)
        .def_readonly("depth_after", &InnerResult::depth_after)
        .def_readonly("outside_before", &InnerResult::outside_before)
        .def_readonly("outside_after", &InnerResult::outside_after)
        .def_readonly("factorisations", &InnerResult::factorisations)
        .def(as_tuple_of(&InnerResult::V, &InnerResult::skin, &InnerResult::stop, &InnerResult::iterations,
                         &InnerResult::energy, &InnerResult::depth_before, &InnerResult::depth_after,
                         &InnerResult::outside_before, &InnerResult::outside_after, &InnerResult::factorisations));
    py::class_<InnerSolver>(m, "InnerSolver")
        .def(py::init([](const BodyModel& model, Vector shape, Vertices J, const py::kwargs& options) {
            return InnerSolver(model, std::move(shape), std::move(J), options_from<InnerOptions>(options, "inner"));
        }))
        .def("fuse", &InnerSolver::fuse, py::call_guard<py::gil_scoped_release>())
        .def("solve", &InnerSolver::solve, py::call_guard<py::gil_scoped_release>());
}

}  // namespace toile::bind
