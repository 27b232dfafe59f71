#include "bind/common.h"

namespace toile::bind {

void bind_inner(py::module_&) {}

}  // namespace toile::bind
