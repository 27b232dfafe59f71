#include "kernels/occlusion.h"

#include "bind/common.h"

namespace toile::bind {

void bind_occlusion(py::module_& m) {
    py::class_<OcclusionOptions>(m, "OcclusionOptions")
        .def(py::init<>())
        .def_readwrite("rays", &OcclusionOptions::rays)
        .def_readwrite("seed", &OcclusionOptions::seed)
        .def_readwrite("relative_offset", &OcclusionOptions::relative_offset)
        .def_readwrite("reach", &OcclusionOptions::reach);
    m.def("ambient_occlusion", [](const Vertices& V, const Faces& F, const Indices& of, const py::kwargs& keywords) {
        const auto options = options_from<OcclusionOptions>(keywords, "ambient_occlusion");
        const Unlocked unlocked;
        return ambient_occlusion(V, F, options, of);
    });
}

}  // namespace toile::bind
