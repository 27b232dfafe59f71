#include "bind/common.h"

namespace toile::bind {

void bind_skeleton(py::module_&) {}

}  // namespace toile::bind
