#include "bind/common.h"

namespace toile::bind {

void bind_biharmonic(py::module_&) {}

}  // namespace toile::bind
