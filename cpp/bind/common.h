// What every binding needs: arrays checked for shape, options from keywords, the GIL released.
#pragma once
#include <pybind11/eigen.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cxxabi.h>
#include <unistd.h>

#include <algorithm>
#include <string>

#include "base/stop.h"
#include "base/types.h"

/// A reason to stop is the string of its name in Python.
template <>
struct pybind11::detail::type_caster<toile::Stop> {
    PYBIND11_TYPE_CASTER(toile::Stop, const_name("str"));

    bool load(handle source, bool) {
        if (!isinstance<str>(source)) return false;
        const auto text = source.cast<std::string>();
        const auto at = std::find(toile::stop_names.begin(), toile::stop_names.end(), text);
        value = static_cast<toile::Stop>(at - toile::stop_names.begin());
        return at != toile::stop_names.end();
    }
    static handle cast(toile::Stop stop, return_value_policy, handle) {
        return str(std::string(toile::name(stop))).release();
    }
};

namespace toile::bind {

namespace py = pybind11;

/// Python's lock, released while this lives. Once the interpreter ends no thread gets the lock any more: Python 3.11 to 3.13
/// unwind a thread that asks for it, which no destructor may let pass, and frames above must not run without the lock. So
/// such a thread rests until the process is gone, as it does from Python 3.14 on.
class Unlocked {
public:
    Unlocked() : thread_(PyEval_SaveThread()) {}
    ~Unlocked() {
        try {
            PyEval_RestoreThread(thread_);
        } catch (const abi::__forced_unwind&) {
            for (;;) pause();
        }
    }
    Unlocked(const Unlocked&) = delete;
    Unlocked& operator=(const Unlocked&) = delete;

private:
    PyThreadState* thread_;
};

/// Fills an options struct from keywords by its bound attributes; an unknown name or another type is a TypeError.
template <class Options>
Options options_from(const py::kwargs& keywords, const char* kernel, Options options = {}) {
    py::object view = py::cast(&options, py::return_value_policy::reference);
    for (const auto& [key, value] : keywords) {
        const auto name = py::cast<std::string>(key);
        if (name.starts_with('_') || !py::hasattr(view, key))
            throw py::type_error(std::string(kernel) + ": no option named '" + name + "'");
        const py::object usual = view.attr(key);
        try {
            view.attr(key) = value;
        } catch (const py::error_already_set&) {
            throw py::type_error(std::string(kernel) + ": " + name + " is " + std::string(py::repr(value)) +
                                 ", expected " + std::string(py::str(usual.get_type().attr("__name__"))) + " like " +
                                 std::string(py::repr(usual)));
        }
    }
    return options;
}

/// Pickles a struct of plain data, also for copy.deepcopy, as the tuple of these members.
template <class T, class... Member>
auto as_tuple_of(Member T::*... members) {
    return py::pickle([=](const T& value) { return py::make_tuple(value.*members...); }, [=](const py::tuple& state) {
        if (state.size() != sizeof...(members)) throw py::value_error("pickled by another version");
        T value;
        std::size_t i = 0;
        ((value.*members = state[i++].cast<Member>()), ...);
        return value;
    });
}

void bind_runtime(py::module_& m);    ///< errors, threads, versions
void bind_geometry(py::module_& m);   ///< normals, loops, closest points: what Python stages share with the kernels
void bind_intersect(py::module_& m);  ///< exact triangle pairs, winding numbers, signed distance
void bind_body_model(py::module_& m);
void bind_nricp(py::module_& m);
void bind_biharmonic(py::module_& m);
void bind_mrf(py::module_& m);
void bind_untangle(py::module_& m);
void bind_skeleton(py::module_& m);
void bind_inner(py::module_& m);
void bind_raster(py::module_& m);
void bind_paint(py::module_& m);
void bind_contours(py::module_& m);
void bind_remesh(py::module_& m);
void bind_occlusion(py::module_& m);
void bind_sight(py::module_& m);  ///< visibility of points, values read from pictures

}  // namespace toile::bind
