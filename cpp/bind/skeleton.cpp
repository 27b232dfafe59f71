#include "kernels/skeleton.h"

#include <optional>

#include "bind/common.h"
#include "geometry/closest.h"

namespace toile::bind {

void bind_skeleton(py::module_& m) {
    py::class_<SkeletonOptions>(m, "SkeletonOptions")
        .def(py::init<>())
        .def_readwrite("surface_weight", &SkeletonOptions::surface_weight)
        .def_readwrite("surface_sigma", &SkeletonOptions::surface_sigma)
        .def_readwrite("surface_robust", &SkeletonOptions::surface_robust)
        .def_readwrite("cloth_fit", &SkeletonOptions::cloth_fit)
        .def_readwrite("reach_start", &SkeletonOptions::reach_start)
        .def_readwrite("reach", &SkeletonOptions::reach)
        .def_readwrite("min_cosine", &SkeletonOptions::min_cosine)
        .def_readwrite("surface_samples", &SkeletonOptions::surface_samples)
        .def_readwrite("keypoint_robust_sigmas", &SkeletonOptions::keypoint_robust_sigmas)
        .def_readwrite("pose_weight", &SkeletonOptions::pose_weight)
        .def_readwrite("shape_weight", &SkeletonOptions::shape_weight)
        .def_readwrite("limit_sigma", &SkeletonOptions::limit_sigma)
        .def_readwrite("joint_twist", &SkeletonOptions::joint_twist)
        .def_readwrite("temporal_sigma", &SkeletonOptions::temporal_sigma)
        .def_readwrite("temporal_translation", &SkeletonOptions::temporal_translation)
        .def_readwrite("solve_shape", &SkeletonOptions::solve_shape)
        .def_readwrite("max_iterations", &SkeletonOptions::max_iterations)
        .def_readwrite("tolerance", &SkeletonOptions::tolerance)
        .def_readwrite("relative_decrease", &SkeletonOptions::relative_decrease)
        .def_readwrite("idle", &SkeletonOptions::idle);
    py::class_<SkeletonPose>(m, "SkeletonPose")
        .def(py::init([](Vertices rotations, Vec3 translation, Vector shape) {
        return SkeletonPose{std::move(rotations), std::move(translation), std::move(shape)};
    })).def(as_tuple_of(&SkeletonPose::rotations, &SkeletonPose::translation, &SkeletonPose::shape));
    py::class_<SkeletonFrame>(m, "SkeletonFrame")
        .def(py::init([](Vertices V, Faces F, Indices index, Vertices points, Vector sigma,
                         std::vector<SkeletonPose> start, std::vector<SkeletonPose> previous, Vector clothed,
                         Vector scan_confidence, std::optional<std::shared_ptr<SurfaceIndex>> scan_index) {
        return SkeletonFrame{std::move(V),
                             std::move(F),
                             {std::move(index), std::move(points), std::move(sigma)},
                             std::move(start),
                             std::move(previous),
                             std::move(clothed),
                             std::move(scan_confidence),
                             scan_index.value_or(nullptr)};
    }));
    py::class_<SkeletonResult>(m, "SkeletonResult")
        .def_property_readonly("rotations", [](const SkeletonResult& r) { return r.pose.rotations; })
        .def_property_readonly("translation", [](const SkeletonResult& r) { return r.pose.translation; })
        .def_property_readonly("shape", [](const SkeletonResult& r) { return r.pose.shape; })
        .def_readonly("V", &SkeletonResult::V)
        .def_readonly("joints", &SkeletonResult::joints)
        .def_readonly("stop", &SkeletonResult::stop)
        .def_readonly("iterations", &SkeletonResult::iterations)
        .def_readonly("energy", &SkeletonResult::energy)
        .def_readonly("rms", &SkeletonResult::rms)
        .def_readonly("matched", &SkeletonResult::matched)
        .def_readonly("keypoint_rms", &SkeletonResult::keypoint_rms)
        .def(as_tuple_of(&SkeletonResult::pose, &SkeletonResult::V, &SkeletonResult::joints, &SkeletonResult::stop,
                         &SkeletonResult::iterations, &SkeletonResult::energy, &SkeletonResult::rms,
                         &SkeletonResult::matched, &SkeletonResult::keypoint_rms));
    py::class_<SkeletonSolver>(m, "SkeletonSolver")
        .def(py::init([](const BodyModel& model, Vector joint_sigma, Vector joint_limit, Vector vertex_weights,
                         const py::kwargs& options) {
        return SkeletonSolver(model, std::move(joint_sigma), std::move(joint_limit), std::move(vertex_weights),
                              options_from<SkeletonOptions>(options, "skeleton"));
    }))
        .def("solve", &SkeletonSolver::solve, py::call_guard<Unlocked>())
        .def("solve_shared", &SkeletonSolver::solve_shared, py::call_guard<Unlocked>());
}

}  // namespace toile::bind
