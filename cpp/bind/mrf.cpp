#include "kernels/mrf.h"

#include "bind/common.h"

namespace toile::bind {

void bind_mrf(py::module_& m) {
    py::class_<MrfOptions>(m, "MrfOptions")
        .def(py::init<>())
        .def_readwrite("max_sweeps", &MrfOptions::max_sweeps)
        .def_readwrite("start", &MrfOptions::start)
        .def_readwrite("prefer", &MrfOptions::prefer)
        .def_readwrite("forbid", &MrfOptions::forbid)
        .def_readwrite("vote_cost", &MrfOptions::vote_cost);
    py::class_<MrfResult>(m, "MrfResult")
        .def_readonly("labels", &MrfResult::labels)
        .def_readonly("energy", &MrfResult::energy)
        .def_readonly("unary_energy", &MrfResult::unary_energy)
        .def_readonly("pairwise_energy", &MrfResult::pairwise_energy)
        .def_readonly("sweep_energy", &MrfResult::sweep_energy)
        .def_readonly("sweeps", &MrfResult::sweeps)
        .def_readonly("expansions", &MrfResult::expansions)
        .def_readonly("stop", &MrfResult::stop)
        .def(as_tuple_of(&MrfResult::labels, &MrfResult::energy, &MrfResult::unary_energy, &MrfResult::pairwise_energy,
                         &MrfResult::sweep_energy, &MrfResult::sweeps, &MrfResult::expansions, &MrfResult::stop));
    m.def("mrf", [](const Matrix& unary, const Edges& edges, const Vector& weights, const Matrix& pairwise,
                    const py::kwargs& keywords) {
        const auto options = options_from<MrfOptions>(keywords, "mrf");
        const Unlocked unlocked;
        return mrf(unary, edges, weights, pairwise, options);
    });
}

}  // namespace toile::bind
