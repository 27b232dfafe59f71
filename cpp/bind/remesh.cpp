#include "kernels/remesh.h"

#include "bind/common.h"

namespace toile::bind {

void bind_remesh(py::module_& m) {
    py::class_<RemeshOptions>(m, "RemeshOptions")
        .def(py::init<>())
        .def_readwrite("iterations", &RemeshOptions::iterations)
        .def_readwrite("crease_angle", &RemeshOptions::crease_angle);
    m.def("remesh", [](const Vertices& V, const Faces& F, double edge, const py::kwargs& keywords) {
        const auto options = options_from<RemeshOptions>(keywords, "remesh");
        RemeshResult result;
        {
            const Unlocked unlocked;
            result = remesh(V, F, edge, options);
        }
        return py::make_tuple(result.V, result.F);
    });
}

}  // namespace toile::bind
