#include "kernels/paint.h"

#include "base/errors.h"
#include "check.h"

using namespace toile;

int main() {
    PaintedMesh mesh;
    mesh.vertices_camera.resize(3, 3);
    mesh.vertices_camera << -1, -1, 2, 3, -1, 2, -1, 3, 2;
    mesh.faces.resize(1, 3);
    mesh.faces << 0, 1, 2;
    mesh.uv.resize(3, 2);
    mesh.uv << 0, 1, 2, 1, 0, -1;
    mesh.face_uv = mesh.faces;
    mesh.first_face = Indices::Zero(1);
    const float texel[] = {0, 1, 2, 3};
    mesh.textures = {{texel, 2, 1}};
    FaceIds face(2, 3);
    face << 0, 0, -1, 0, 0, -1;
    Mat3 K;
    K << 2, 0, 1, 0, 2, 1, 0, 0, 1;

    LAW("pixels at texels' centres have their colours, empty ones are 0");
    const Planes picture = paint(mesh, face, K);
    Planes expected(1, 6);
    expected << 0, 1, 0, 2, 3, 0;
    CHECK((picture - expected).cwiseAbs().maxCoeff() < 1e-6f);

    LAW("bad input is refused");
    face(0, 0) = 1;
    CHECK_THROWS(InputError, paint(mesh, face, K));
    face(0, 0) = 0;
    mesh.textures[0].size = 0;
    CHECK_THROWS(InputError, paint(mesh, face, K));
    return toile_failures();
}
