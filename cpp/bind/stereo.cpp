#include "kernels/stereo.h"

#include <pybind11/numpy.h>

#include <algorithm>
#include <memory>

#include "base/errors.h"
#include "bind/common.h"

namespace toile::bind {

namespace {

using FloatImages = py::array_t<float, py::array::c_style>;
using Bytes = py::array_t<std::uint8_t, py::array::c_style>;

/// An array that owns a vector's numbers.
template <class T>
py::array_t<T> as_array(std::vector<T> values, const std::vector<py::ssize_t>& shape) {
    auto kept = std::make_unique<std::vector<T>>(std::move(values));
    T* data = kept->data();
    const py::capsule owner(kept.release(), [](void* p) { delete static_cast<std::vector<T>*>(p); });
    return py::array_t<T>(shape, data, owner);
}

py::tuple solve(const StereoSolver& solver, const FloatImages& grey, const Bytes& mask, const Matrix& ranges) {
    const auto count = static_cast<py::ssize_t>(solver.cameras().size());
    if (grey.ndim() != 3 || mask.ndim() != 3 || grey.shape(0) != count || ranges.rows() != count ||
        ranges.cols() != 2 || mask.shape(0) != count || mask.shape(1) != grey.shape(1) ||
        mask.shape(2) != grey.shape(2))
        throw InputError("stereo: images, masks and depth_range are not of one size, or not one a camera");
    const std::vector<py::ssize_t> shape{count, grey.shape(1), grey.shape(2)}, shape3{count, shape[1], shape[2], 3};
    const StereoPictures pictures{grey.data(), mask.data(), static_cast<int>(shape[1]), static_cast<int>(shape[2])};
    StereoMaps maps;
    {
        const Unlocked unlocked;
        maps = solver.solve(pictures, ranges);
    }
    return py::make_tuple(as_array(std::move(maps.depth), shape), as_array(std::move(maps.normal), shape3),
                          as_array(std::move(maps.confidence), shape), as_array(std::move(maps.hole), shape));
}

py::tuple fuse(const std::vector<StereoCamera>& cameras, const FloatImages& depth, const FloatImages& normal,
               const FloatImages& confidence, const py::kwargs& keywords) {
    const auto count = static_cast<py::ssize_t>(cameras.size());
    const auto fits = [&](const FloatImages& maps, py::ssize_t dimensions) {
        return maps.ndim() == dimensions && std::equal(depth.shape(), depth.shape() + 3, maps.shape());
    };
    if (depth.ndim() != 3 || depth.shape(0) != count || !fits(confidence, 3) || !fits(normal, 4) ||
        normal.shape(3) != 3)
        throw InputError("fuse_depths: depth, normal and confidence are not of one size, or not one a camera");
    const auto options = options_from<FuseOptions>(keywords, "fuse_depths");
    FusedPoints fused;
    {
        const Unlocked unlocked;
        fused = fuse_depths(cameras, depth.data(), normal.data(), confidence.data(), static_cast<int>(depth.shape(1)),
                            static_cast<int>(depth.shape(2)), options);
    }
    return py::make_tuple(std::move(fused.points), std::move(fused.normals), std::move(fused.confidence),
                          std::move(fused.views));
}

}  // namespace

void bind_stereo(py::module_& m) {
    py::class_<StereoCamera>(m, "StereoCamera")
        .def(py::init<Mat3, Eigen::Matrix4d, int, int>())
        .def_readonly("height", &StereoCamera::height)
        .def_readonly("width", &StereoCamera::width);
    py::class_<StereoOptions>(m, "StereoOptions")
        .def(py::init<>())
        .def_readwrite("sources", &StereoOptions::sources)
        .def_readwrite("best", &StereoOptions::best)
        .def_readwrite("max_angle", &StereoOptions::max_angle)
        .def_readwrite("coarsest", &StereoOptions::coarsest)
        .def_readwrite("start_iterations", &StereoOptions::start_iterations)
        .def_readwrite("coarse_iterations", &StereoOptions::coarse_iterations)
        .def_readwrite("iterations", &StereoOptions::iterations)
        .def_readwrite("refinements", &StereoOptions::refinements)
        .def_readwrite("spacing", &StereoOptions::spacing)
        .def_readwrite("colour", &StereoOptions::colour)
        .def_readwrite("noise", &StereoOptions::noise)
        .def_readwrite("consistency", &StereoOptions::consistency)
        .def_readwrite("contradiction", &StereoOptions::contradiction)
        .def_readwrite("max_cost", &StereoOptions::max_cost)
        .def_readwrite("agreement", &StereoOptions::agreement)
        .def_readwrite("min_views", &StereoOptions::min_views)
        .def_readwrite("seed", &StereoOptions::seed);
    py::class_<FuseOptions>(m, "FuseOptions")
        .def(py::init<>())
        .def_readwrite("agreement", &FuseOptions::agreement)
        .def_readwrite("min_cosine", &FuseOptions::min_cosine)
        .def_readwrite("min_views", &FuseOptions::min_views);
    py::class_<StereoSolver>(m, "StereoSolver")
        .def(py::init([](std::vector<StereoCamera> cameras, const py::kwargs& keywords) {
        return StereoSolver(std::move(cameras), options_from<StereoOptions>(keywords, "stereo"));
    })).def("solve", &solve);
    m.def("fuse_depths", &fuse);
}

}  // namespace toile::bind
