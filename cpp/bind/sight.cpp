#include "kernels/sight.h"

#include <pybind11/numpy.h>

#include <algorithm>
#include <optional>

#include "base/errors.h"
#include "bind/common.h"

namespace toile::bind {

namespace {

using Pixels = py::array_t<float, py::array::c_style | py::array::forcecast>;

Readings read_pixels(const Pixels& pixels, const Eigen::Ref<const Matrix>& uv) {
    const Picture picture{pixels.data(), pixels.shape(0), pixels.shape(1), pixels.shape(2)};
    const Unlocked unlocked;
    return bilinear(picture, uv);
}

using Depth = py::array_t<double, py::array::c_style>;

/// A view whose arrays are numpy's. Calls take copies: another thread may change the list that they came in.
struct BoundView {
    Depth depth;
    Pixels pixels;
    View view;
};

BoundView view_of(const Mat3& K, Vector distortion, const Eigen::Matrix4d& T, Depth depth, Pixels pixels,
                  const Eigen::Vector2d& corner) {
    if (depth.ndim() != 2 || pixels.ndim() != 3) throw InputError("View: depth is not (H,W), or picture not (H,W,C)");
    const View view{{K, std::move(distortion), T},
                    {depth.data(), depth.shape(0), depth.shape(1)},
                    {pixels.data(), pixels.shape(0), pixels.shape(1), pixels.shape(2)},
                    corner};
    return {std::move(depth), std::move(pixels), view};
}

using Labels = py::array_t<std::uint8_t, py::array::c_style>;

/// Hands the values over without a copy.
py::array_t<float> as_picture(std::vector<float> values, std::int64_t height, std::int64_t width) {
    auto* const kept = new std::vector<float>(std::move(values));
    const py::capsule owner(kept, [](void* p) { delete static_cast<std::vector<float>*>(p); });
    const auto channels = static_cast<std::int64_t>(kept->size()) / std::max<std::int64_t>(height * width, 1);
    return py::array_t<float>({height, width, channels}, kept->data(), owner);
}

LabelImage label_image(const Labels& labels) {
    require(labels.ndim() == 2 && labels.size() > 0, "soft_labels: labels is not (H,W) of one pixel or more");
    return {labels.data(), labels.shape(0), labels.shape(1)};
}

py::array_t<float> bound_soft_labels(const Labels& labels, const std::vector<std::uint8_t>& ids, double blur) {
    const LabelImage image = label_image(labels);
    std::vector<float> out;
    {
        const Unlocked unlocked;
        out = soft_labels(image, ids, blur);
    }
    return as_picture(std::move(out), image.height, image.width);
}

py::array_t<float> bound_picture(const Labels& labels, const std::vector<std::uint8_t>& ids, const PixelMask& clear,
                                 const std::optional<Pixels>& likelihood, const std::optional<Labels>& rgb, double blur,
                                 double empty_blur) {
    const LabelImage image = label_image(labels);
    const std::int64_t n = image.height * image.width;
    require(clear.size() == n, "evidence_picture: clear has another size than labels");
    const std::int64_t count = clear.count();  // of a copy: likelihood has a row for each, whatever another thread does
    require(!likelihood || likelihood->size() == count * static_cast<std::int64_t>(ids.size()),
            "evidence_picture: likelihood has another number of rows than clear has pixels, or of columns than ids");
    require(!rgb || rgb->size() == 3 * n, "evidence_picture: rgb has another size than labels");
    std::vector<float> out;
    {
        const Unlocked unlocked;
        out = evidence_picture(image, ids, clear.data(), likelihood ? likelihood->data() : nullptr,
                               rgb ? rgb->data() : nullptr, blur, empty_blur);
    }
    return as_picture(std::move(out), image.height, image.width);
}

std::vector<View> views_of(const std::vector<BoundView>& bound) {
    std::vector<View> views;
    for (const BoundView& b : bound) views.push_back(b.view);
    return views;
}

}  // namespace

void bind_sight(py::module_& m) {
    py::class_<OddsOptions>(m, "OddsOptions")
        .def(py::init<>())
        .def_readwrite("tolerance", &OddsOptions::tolerance)
        .def_readwrite("min_cosine", &OddsOptions::min_cosine)
        .def_readwrite("floating", &OddsOptions::floating)
        .def_readwrite("behind", &OddsOptions::behind)
        .def_readwrite("most", &OddsOptions::most)
        .def_readwrite("free", &OddsOptions::free);
    py::class_<EdgeOptions>(m, "EdgeOptions")
        .def(py::init<>())
        .def_readwrite("tolerance", &EdgeOptions::tolerance)
        .def_readwrite("min_cosine", &EdgeOptions::min_cosine)
        .def_readwrite("flank", &EdgeOptions::flank)
        .def_readwrite("contrast", &EdgeOptions::contrast)
        .def_readwrite("disorder", &EdgeOptions::disorder)
        .def_readwrite("shift", &EdgeOptions::shift);
    py::class_<BoundView>(m, "View").def(py::init(&view_of));
    m.def("view_odds", [](const std::vector<BoundView>& bound, const Vertices& points, const Vertices& normals,
                          int labels, int column, const Indices& rival, const py::kwargs& options) {
        const std::vector<View> views = views_of(bound);
        const auto chosen = options_from<OddsOptions>(options, "view_odds");
        const Unlocked unlocked;
        return view_odds(views, points, normals, labels, column, rival, chosen);
    });
    m.def("view_edges", [](const std::vector<BoundView>& bound, const Vertices& points, const Vertices& normals,
                           int labels, const Vector& s, const py::kwargs& options) {
        const std::vector<View> views = views_of(bound);
        const auto chosen = options_from<EdgeOptions>(options, "view_edges");
        const Unlocked unlocked;
        return view_edges(views, points, normals, labels, s, chosen);
    });
    m.def("undistorted_view",
          [](const Vertices& points, const Mat3& K, const Vector& distortion, const Eigen::Matrix4d& T) {
        const Unlocked unlocked;
        return undistorted_view(points, {K, distortion, T});
    });
    m.def("visibility",
          [](const Vertices& points, const Vertices& normals, const Mat3& K, const Vector& distortion,
             const Eigen::Matrix4d& T, const Eigen::Ref<const Matrix>& depth, double tolerance, double min_cosine) {
        Sight sight;
        {
            const Unlocked unlocked;
            sight = visibility(points, normals, {K, distortion, T}, depth, tolerance, min_cosine);
        }
        return py::make_tuple(std::move(sight.uv), std::move(sight.weight), std::move(sight.clearance));
    });
    m.def("bilinear", &read_pixels);
    m.def("soft_labels", &bound_soft_labels);
    m.def("evidence_picture", &bound_picture);
}

}  // namespace toile::bind
