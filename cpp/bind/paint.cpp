#include "kernels/paint.h"

#include <pybind11/numpy.h>

#include "base/errors.h"
#include "bind/common.h"

namespace toile::bind {

namespace {

using Texels = py::array_t<float, py::array::c_style>;

Texture texture_of(const Texels& texels) {
    if (texels.ndim() != 3 || texels.shape(0) != texels.shape(1)) throw InputError("paint: a texture is not (T,T,C)");
    return {texels.data(), texels.shape(0), texels.shape(2)};
}

}  // namespace

void bind_paint(py::module_& m) {
    m.def("paint", [](const FaceIds& face, const Vertices& V, const Faces& F, const Matrix& uv, const Faces& face_uv,
                      const Mat3& K, const Indices& first_face, const std::vector<Texels>& textures, double edge_on) {
        PaintedMesh mesh{V, F, uv, face_uv, first_face, {}};
        for (const Texels& texels : textures) mesh.textures.push_back(texture_of(texels));
        const Unlocked unlocked;
        return paint(mesh, face, K, edge_on);
    });
}

}  // namespace toile::bind
