#include "kernels/inner.h"

#include "bind/common.h"

namespace toile::bind {

void bind_inner(py::module_& m) {
    py::class_<InnerOptions>(m, "InnerOptions")
        .def(py::init<>())
        .def_readwrite("length", &InnerOptions::length)
        .def_readwrite("skin", &InnerOptions::skin)
        .def_readwrite("out", &InnerOptions::out)
        .def_readwrite("fit", &InnerOptions::fit)
        .def_readwrite("fit_scale", &InnerOptions::fit_scale)
        .def_readwrite("swing", &InnerOptions::swing)
        .def_readwrite("still", &InnerOptions::still)
        .def_readwrite("swing_error", &InnerOptions::swing_error)
        .def_readwrite("misfit", &InnerOptions::misfit)
        .def_readwrite("prior", &InnerOptions::prior)
        .def_readwrite("gap", &InnerOptions::gap)
        .def_readwrite("seldom", &InnerOptions::seldom)
        .def_readwrite("often", &InnerOptions::often)
        .def_readwrite("taper", &InnerOptions::taper)
        .def_readwrite("reach", &InnerOptions::reach)
        .def_readwrite("tightness", &InnerOptions::tightness)
        .def_readwrite("inward", &InnerOptions::inward)
        .def_readwrite("shape_sigma", &InnerOptions::shape_sigma)
        .def_readwrite("shape_observations", &InnerOptions::shape_observations)
        .def_readwrite("rounds", &InnerOptions::rounds)
        .def_readwrite("tolerance", &InnerOptions::tolerance)
        .def_readwrite("max_iterations", &InnerOptions::max_iterations);
    py::class_<InnerGarment>(m, "InnerGarment").def(py::init([](Vertices V, Faces F) {
        return InnerGarment{std::move(V), std::move(F)};
    }));
    py::class_<InnerFrame>(m, "InnerFrame")
        .def(py::init([](Vertices rotations, Vec3 translation, Vertices tracked, Vector visible,
                         std::vector<InnerGarment> garments) {
        return InnerFrame{std::move(rotations), std::move(translation), std::move(tracked), std::move(visible),
                          std::move(garments)};
    }));
    py::class_<InnerFused>(m, "InnerFused")
        .def_readonly("rest", &InnerFused::rest)
        .def_readonly("shape", &InnerFused::shape)
        .def_readonly("bound", &InnerFused::bound)
        .def_readonly("stop", &InnerFused::stop)
        .def_readonly("iterations", &InnerFused::iterations)
        .def_readonly("energy", &InnerFused::energy)
        .def_readonly("observed", &InnerFused::observed)
        .def_readonly("bounded", &InnerFused::bounded)
        .def_readonly("factorisations", &InnerFused::factorisations)
        .def_readonly("analyses", &InnerFused::analyses)
        .def(as_tuple_of(&InnerFused::rest, &InnerFused::shape, &InnerFused::bound, &InnerFused::stop,
                         &InnerFused::iterations, &InnerFused::energy, &InnerFused::observed, &InnerFused::bounded,
                         &InnerFused::factorisations, &InnerFused::analyses));
    py::class_<InnerResult>(m, "InnerResult")
        .def_readonly("V", &InnerResult::V)
        .def_readonly("skin", &InnerResult::skin)
        .def_readonly("stop", &InnerResult::stop)
        .def_readonly("iterations", &InnerResult::iterations)
        .def_readonly("energy", &InnerResult::energy)
        .def_readonly("depth_before", &InnerResult::depth_before)
        .def_readonly("depth_after", &InnerResult::depth_after)
        .def_readonly("outside_before", &InnerResult::outside_before)
        .def_readonly("outside_after", &InnerResult::outside_after)
        .def_readonly("factorisations", &InnerResult::factorisations)
        .def_readonly("analyses", &InnerResult::analyses)
        .def(as_tuple_of(&InnerResult::V, &InnerResult::skin, &InnerResult::stop, &InnerResult::iterations,
                         &InnerResult::energy, &InnerResult::depth_before, &InnerResult::depth_after,
                         &InnerResult::outside_before, &InnerResult::outside_after, &InnerResult::factorisations,
                         &InnerResult::analyses));
    py::class_<InnerGuess>(m, "InnerGuess")
        .def(py::init([](Vertices rest, Vertices skin_mean, bool asks_skin) {
        return InnerGuess{std::move(rest), std::move(skin_mean), asks_skin};
    }))
        .def(as_tuple_of(&InnerGuess::rest, &InnerGuess::skin_mean, &InnerGuess::asks_skin))
        .def_readonly("rest", &InnerGuess::rest)
        .def_readonly("skin_mean", &InnerGuess::skin_mean)
        .def_readonly("asks_skin", &InnerGuess::asks_skin);
    py::class_<InnerSums>(m, "InnerSums")
        .def(py::init([](Vertices position, Vector weight, Vector skin, RoomCounts room, std::int64_t frames) {
        return InnerSums{std::move(position), std::move(weight), std::move(skin), std::move(room), frames};
    }))
        .def(as_tuple_of(&InnerSums::position, &InnerSums::weight, &InnerSums::skin, &InnerSums::room,
                         &InnerSums::frames))
        .def("__iadd__", &InnerSums::operator+=)
        .def_readonly("position", &InnerSums::position)
        .def_readonly("weight", &InnerSums::weight)
        .def_readonly("skin", &InnerSums::skin)
        .def_readonly("room", &InnerSums::room)
        .def_readonly("frames", &InnerSums::frames);
    py::class_<InnerSolver>(m, "InnerSolver")
        .def(py::init([](const BodyModel& model, Vector shape, Vertices J, const py::kwargs& options) {
        return InnerSolver(model, std::move(shape), std::move(J), options_from<InnerOptions>(options, "inner"));
    }))
        .def("fuse", &InnerSolver::fuse, py::call_guard<Unlocked>())
        .def("sums", &InnerSolver::sums)
        .def("gather", &InnerSolver::gather, py::call_guard<Unlocked>())
        .def("solve", &InnerSolver::solve, py::call_guard<Unlocked>());
    py::class_<InnerFusion>(m, "InnerFusion")
        .def(py::init<const InnerSolver&>(), py::keep_alive<1, 2>())
        .def_property_readonly("done", &InnerFusion::done)
        .def_property_readonly("guess", &InnerFusion::guess)
        .def_property_readonly("fused", &InnerFusion::fused)
        .def("step", &InnerFusion::step, py::call_guard<Unlocked>());
}

}  // namespace toile::bind
