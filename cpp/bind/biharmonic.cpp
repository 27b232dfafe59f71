#include "kernels/biharmonic.h"

#include "bind/common.h"

namespace toile::bind {

void bind_biharmonic(py::module_& m) {
    py::class_<BiharmonicOptions>(m, "BiharmonicOptions")
        .def(py::init<>())
        .def_readwrite("accuracy", &BiharmonicOptions::accuracy)
        .def_readwrite("refinements", &BiharmonicOptions::refinements);
    py::class_<BiharmonicSolver>(m, "BiharmonicSolver")
        .def(py::init([](const Vertices& V, const Faces& F, const Indices& known, const py::kwargs& keywords) {
        const auto options = options_from<BiharmonicOptions>(keywords, "biharmonic");
        const Unlocked unlocked;
        return std::make_unique<BiharmonicSolver>(V, F, known, options);
    }))
        .def("solve", &BiharmonicSolver::solve, py::call_guard<Unlocked>())
        .def_property_readonly("factorisations", &BiharmonicSolver::factorisations)
        .def_property_readonly("mollified", &BiharmonicSolver::mollified)
        .def_property_readonly("factor_error", &BiharmonicSolver::factor_error);
}

}  // namespace toile::bind
