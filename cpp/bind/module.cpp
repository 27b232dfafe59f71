#include <omp.h>

#include "base/errors.h"
#include "base/parallel.h"
#include "bind/common.h"

namespace toile::bind {

void bind_runtime(py::module_& m) {
    py::register_exception<InputError>(m, "InputError", PyExc_ValueError);
    py::register_exception<SolveError>(m, "SolveError", PyExc_RuntimeError);
    m.attr("stop_names") = py::cast(std::vector<std::string>(stop_names.begin(), stop_names.end()));
    m.def("set_threads",
          [](int n) {
        if (n < 1) throw InputError("set_threads: n is " + std::to_string(n) + ", expected at least 1");
        omp_set_num_threads(n);
    },
          "How many threads kernels may use that are called from this thread of Python. A forked child has one all the "
          "same.");
    m.def("threads", &thread_count, "How many threads a kernel called from here may use; 1 in a forked child.");
}

void bind_drape(py::module_& m);
void bind_stereo(py::module_& m);

}  // namespace toile::bind

PYBIND11_MODULE(checked, m) {
    using namespace toile::bind;
    bind_runtime(m);
    bind_geometry(m);
    bind_intersect(m);
    bind_body_model(m);
    bind_nricp(m);
    bind_biharmonic(m);
    bind_mrf(m);
    bind_untangle(m);
    bind_drape(m);
    bind_skeleton(m);
    bind_inner(m);
    bind_raster(m);
    bind_paint(m);
    bind_contours(m);
    bind_remesh(m);
    bind_occlusion(m);
    bind_sight(m);
    bind_stereo(m);
}

/// pybind11 would wait for ever in a sub-interpreter of Python 3.11, and types of one are not those of another.
extern "C" PYBIND11_EXPORT PyObject* PyInit__core() {
    if (PyInterpreterState_Get() == PyInterpreterState_Main()) return PyInit_checked();
    PyErr_SetString(PyExc_ImportError,
                    "toile._core serves the main interpreter of a process alone, no sub-interpreter");
    return nullptr;
}
