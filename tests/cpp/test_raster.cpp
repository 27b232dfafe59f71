#include "base/errors.h"
#include "check.h"
#include "kernels/raster.h"

using namespace toile;

int main() {
    Vertices V(4, 3);
    V << -1, -1, 2, 1, -1, 2, 1, 1, 2, -1, 1, 2;
    Faces F(2, 3);
    F << 0, 1, 2, 0, 2, 3;
    Mat3 K;
    K << 16, 0, 8, 0, 16, 8, 0, 0, 1;

    LAW("a square that fills the image covers each pixel once, at its own depth");
    const RasterResult image = raster(V, F, K, 16, 16);
    CHECK((image.face.array() >= 0).all() && (image.depth.array() == 2).all());
    const auto lower = (image.face.array() == 0).count(), upper = (image.face.array() == 1).count();
    CHECK(lower + upper == 256 && std::abs(lower - upper) <= 16);

    LAW("barycentrics come only on request");
    CHECK(image.barycentric.rows() == 0);
    RasterOptions options;
    options.barycentric = true;
    CHECK(raster(V, F, K, 16, 16, options).barycentric.rows() == 256);

    LAW("bad input is refused");
    F(0, 0) = 4;
    CHECK_THROWS(InputError, raster(V, F, K, 16, 16));
    F(0, 0) = 0;
    CHECK_THROWS(InputError, raster(V, F, Mat3::Zero(), 16, 16));
    return toile_failures();
}
