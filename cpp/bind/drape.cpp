#include "kernels/drape.h"

#include "bind/common.h"

namespace toile::bind {

void bind_drape(py::module_& m) {
    py::class_<DrapeOptions>(m, "DrapeOptions")
        .def(py::init<>())
        .def_readwrite("gravity", &DrapeOptions::gravity)
        .def_readwrite("density", &DrapeOptions::density)
        .def_readwrite("stretch", &DrapeOptions::stretch)
        .def_readwrite("bending", &DrapeOptions::bending)
        .def_readwrite("friction", &DrapeOptions::friction)
        .def_readwrite("margin", &DrapeOptions::margin)
        .def_readwrite("drag", &DrapeOptions::drag)
        .def_readwrite("dry_drag", &DrapeOptions::dry_drag)
        .def_readwrite("substep", &DrapeOptions::substep)
        .def_readwrite("max_depth", &DrapeOptions::max_depth);
    py::class_<DrapeResult>(m, "DrapeResult")
        .def_readonly("V", &DrapeResult::V)
        .def_readonly("contacts", &DrapeResult::contacts)
        .def_readonly("inside", &DrapeResult::inside)
        .def_readonly("strain", &DrapeResult::strain)
        .def(as_tuple_of(&DrapeResult::V, &DrapeResult::contacts, &DrapeResult::inside, &DrapeResult::strain));
    py::class_<DrapeSolver>(m, "DrapeSolver")
        .def(py::init([](const Faces& cloth_F, Eigen::Index cloth_n, const Vector& lengths, const Faces& body_F,
                         Eigen::Index body_n, const Indices& held, const py::kwargs& options) {
        const auto chosen = options_from<DrapeOptions>(options, "drape");
        const Unlocked unlocked;
        return std::make_unique<DrapeSolver>(cloth_F, cloth_n, lengths, body_F, body_n, held, chosen);
    }))
        .def("start", &DrapeSolver::start, py::call_guard<Unlocked>())
        .def("step", &DrapeSolver::step, py::call_guard<Unlocked>());
}

}  // namespace toile::bind
