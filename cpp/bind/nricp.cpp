#include "kernels/nricp.h"

#include "bind/common.h"

namespace toile::bind {

void bind_nricp(py::module_& m) {
    py::class_<NricpOptions>(m, "NricpOptions")
        .def(py::init<>())
        .def_readwrite("large_motion", &NricpOptions::large_motion)
        .def_readwrite("rebase", &NricpOptions::rebase)
        .def_readwrite("passes", &NricpOptions::passes)
        .def_readwrite("relative_radii", &NricpOptions::relative_radii)
        .def_readwrite("iterations", &NricpOptions::iterations)
        .def_readwrite("stiffness_start", &NricpOptions::stiffness_start)
        .def_readwrite("stiffness_end", &NricpOptions::stiffness_end)
        .def_readwrite("relative_robust_start", &NricpOptions::relative_robust_start)
        .def_readwrite("relative_robust_end", &NricpOptions::relative_robust_end)
        .def_readwrite("reverse", &NricpOptions::reverse)
        .def_readwrite("fine_iterations", &NricpOptions::fine_iterations)
        .def_readwrite("fine_sweeps", &NricpOptions::fine_sweeps)
        .def_readwrite("relative_fine_length", &NricpOptions::relative_fine_length)
        .def_readwrite("relative_fine_robust", &NricpOptions::relative_fine_robust)
        .def_readwrite("relative_spread", &NricpOptions::relative_spread)
        .def_readwrite("relative_detail", &NricpOptions::relative_detail)
        .def_readwrite("fine_noise", &NricpOptions::fine_noise)
        .def_readwrite("settled", &NricpOptions::settled)
        .def_readwrite("phong", &NricpOptions::phong)
        .def_readwrite("point_weight", &NricpOptions::point_weight)
        .def_readwrite("boundary_weight", &NricpOptions::boundary_weight)
        .def_readwrite("border_weight", &NricpOptions::border_weight)
        .def_readwrite("rotation_weight", &NricpOptions::rotation_weight)
        .def_readwrite("min_overlap", &NricpOptions::min_overlap)
        .def_readwrite("exposure", &NricpOptions::exposure)
        .def_readwrite("labels", &NricpOptions::labels);
    py::class_<NricpResult>(m, "NricpResult")
        .def_readonly("V", &NricpResult::V)
        .def_readonly("stop", &NricpResult::stop)
        .def_readonly("iterations", &NricpResult::iterations)
        .def_readonly("energy", &NricpResult::energy)
        .def_readonly("rms", &NricpResult::rms)
        .def_readonly("matched", &NricpResult::matched)
        .def(as_tuple_of(&NricpResult::V, &NricpResult::stop, &NricpResult::iterations, &NricpResult::energy,
                         &NricpResult::rms, &NricpResult::matched));
    using RowSparse = Eigen::SparseMatrix<double, Eigen::RowMajor>;
    py::class_<NricpFrame>(m, "NricpFrame")
        .def(py::init([](Vertices V, Faces F, Vertices start, RowSparse W, Vertices P, Vector sigma,
                         const std::vector<std::pair<Indices, Vertices>>& boundary, Indices labels, Vector confidence) {
        NricpFrame frame{
            std::move(V), std::move(F),      std::move(start),     {std::move(W), std::move(P), std::move(sigma)},
            {},           std::move(labels), std::move(confidence)};
        for (const auto& [vertices, polyline] : boundary) frame.loops.push_back({vertices, polyline});
        return frame;
    }));
    py::class_<NricpSolver>(m, "NricpSolver")
        .def(py::init([](const Vertices& V, const Faces& F, const std::string& preset, const py::kwargs& options) {
        const auto chosen = options_from<NricpOptions>(options, "nricp", nricp_preset(preset));
        const Unlocked unlocked;
        return std::make_unique<NricpSolver>(V, F, chosen);
    }))
        .def("solve", &NricpSolver::solve, py::call_guard<Unlocked>())
        .def_property_readonly("analyses", [](const NricpSolver& s) {
        const Unlocked unlocked;  // waits for a solve
        return s.analyses();
    }).def_property_readonly("factorisations", [](const NricpSolver& s) {
        const Unlocked unlocked;
        return s.factorisations();
    });
}

}  // namespace toile::bind
