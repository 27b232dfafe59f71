// What every binding needs: arrays checked for shape, options from keywords, the GIL released.
#pragma once
#include <pybind11/eigen.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "base/types.h"

namespace toile::bind {

namespace py = pybind11;

/// Fills an options struct from keywords by its bound attributes; an unknown name is a TypeError.
template <class Options>
Options options_from(const py::kwargs& keywords, const char* kernel, Options options = {}) {
    py::object view = py::cast(&options, py::return_value_policy::reference);
    for (const auto& [key, value] : keywords) {
        if (!py::hasattr(view, key))
            throw py::type_error(std::string(kernel) + ": no option named '" + py::cast<std::string>(key) + "'");
        view.attr(key) = value;
    }
    return options;
}

/// Pickles a struct of plain data, also for copy.deepcopy, as the tuple of these members.
template <class T, class... Member>
auto as_tuple_of(Member T::*... members) {
    return py::pickle([=](const T& value) { return py::make_tuple(value.*members...); },
                      [=](const py::tuple& state) {
                          if (state.size() != sizeof...(members)) throw py::value_error("pickled by another version");
                          T value;
                          std::size_t i = 0;
                          ((value.*members = state[i++].cast<Member>()), ...);
                          return value;
                      });
}

void bind_runtime(py::module_& m);  ///< errors, threads, versions
void bind_geometry(py::module_& m); ///< normals, loops, closest points: what Python stages share with the kernels
void bind_intersect(py::module_& m); ///< exact triangle pairs, winding numbers, signed distance
void bind_body_model(py::module_& m);
void bind_nricp(py::module_& m);
void bind_biharmonic(py::module_& m);
void bind_mrf(py::module_& m);
void bind_untangle(py::module_& m);
void bind_skeleton(py::module_& m);
void bind_inner(py::module_& m);
void bind_raster(py::module_& m);
void bind_occlusion(py::module_& m);
void bind_sight(py::module_& m); ///< visibility of points, values read from pictures

}  // namespace toile::bind
