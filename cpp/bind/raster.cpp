#include "bind/common.h"

namespace toile::bind {

void bind_raster(py::module_&) {}

}  // namespace toile::bind
