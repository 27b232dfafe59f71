#include "kernels/raster.h"

#include "bind/common.h"

namespace toile::bind {

void bind_raster(py::module_& m) {
    py::class_<RasterOptions>(m, "RasterOptions")
        .def(py::init<>())
        .def_readwrite("barycentric", &RasterOptions::barycentric)
        .def_readwrite("near_plane", &RasterOptions::near_plane);
    py::class_<RasterResult>(m, "RasterResult")
        .def_readonly("face", &RasterResult::face)
        .def_readonly("depth", &RasterResult::depth)
        .def_property_readonly("barycentric", [](const RasterResult& r) -> py::object {
        if (r.barycentric.rows() == 0) return py::none();
        return py::cast(r.barycentric).attr("reshape")(r.face.rows(), r.face.cols(), 3);
    }).def(as_tuple_of(&RasterResult::face, &RasterResult::depth, &RasterResult::barycentric));
    m.def("raster",
          [](const Vertices& V, const Faces& F, const Mat3& K, int height, int width, const py::kwargs& keywords) {
        const auto options = options_from<RasterOptions>(keywords, "raster");
        const Unlocked unlocked;
        return raster(V, F, K, height, width, options);
    });
}

}  // namespace toile::bind
