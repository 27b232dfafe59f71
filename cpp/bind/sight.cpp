#include "kernels/sight.h"

#include <pybind11/numpy.h>

#include "bind/common.h"

namespace toile::bind {

namespace {

using Pixels = py::array_t<float, py::array::c_style | py::array::forcecast>;

Readings read_pixels(const Pixels& pixels, const Eigen::Ref<const Matrix>& uv) {
    const Picture picture{pixels.data(), pixels.shape(0), pixels.shape(1), pixels.shape(2)};
    py::gil_scoped_release release;
    return bilinear(picture, uv);
}

}  // namespace

void bind_sight(py::module_& m) {
    m.def("visibility",
          [](const Vertices& points, const Vertices& normals, const Mat3& K, const Vector& distortion,
             const Eigen::Matrix4d& T, const Eigen::Ref<const Matrix>& depth, double tolerance, double min_cosine) {
        Sight sight;
        {
            py::gil_scoped_release release;
            sight = visibility(points, normals, {K, distortion, T}, depth, tolerance, min_cosine);
        }
        return py::make_tuple(std::move(sight.uv), std::move(sight.weight), std::move(sight.clearance));
    });
    m.def("bilinear", &read_pixels);
}

}  // namespace toile::bind
